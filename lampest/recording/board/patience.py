"""How long a line may talk without a frame that fits."""

import time
from collections import Counter

from lampest.files.errors import InputError
from lampest.recording.board.protocol import Frame, Garbage, Message

UNFIT_SECONDS = 30.0


class UnfitError(InputError):
    """The line talks and talks, but no frame that fits comes."""


class Patience:
    """Since when nothing has fitted, and what came instead; that is its only state.

    A line that is silent, or a port that is gone, may be waited for; one that talks may not without end.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._since = time.monotonic()
        self._heard = Counter[str]()

    def renew(self) -> None:
        """A frame fitted, or nobody is there."""
        self._since = time.monotonic()
        self._heard.clear()

    def hear(self, item: Message, out_of_order: bool) -> None:
        """Something came that is no frame that fits."""
        if isinstance(item, Frame):
            kind = "frames out of order" if out_of_order else "frames of another size"
        else:
            kind = "pieces that are no message" if isinstance(item, Garbage) else "answers"
        self._heard[kind] += 1

    def check(self, period_us: int = 0) -> None:
        """Raise UnfitError where the line has talked for 30 s and three periods, and nothing fitted."""
        waited = time.monotonic() - self._since
        if self._heard and waited > UNFIT_SECONDS + 3e-6 * period_us:
            came = ", ".join(f"{number} {kind}" for kind, number in self._heard.most_common())
            raise UnfitError(f"{self._url}: nothing fit for {waited:.0f} s, though the line is not silent ({came})")
