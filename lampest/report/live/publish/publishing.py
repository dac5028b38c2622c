"""Every way in a thread of its own, which takes the newest frame and leaves out those that came meanwhile."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from threading import Thread

from lampest.report.live.newest import Newest
from lampest.report.live.publish.message import Message
from lampest.report.live.publish.publish import Publish, Say, Send
from lampest.report.live.view import View


@contextmanager
def publishing(ways: Sequence[Publish], shown: Newest[View], say: Say) -> Iterator[tuple[str, ...]]:
    """Publish every frame that is shown until nothing more will come: where each of the ways is found.

    say : told once when a way fails, and when it is there again. Raises InputError where one cannot be opened.
    """
    with ExitStack() as opened:
        outlets = [opened.enter_context(way.opened(say)) for way in ways]
        threads = [
            Thread(target=_forward, args=(shown, send, where, say), name="lampest-publish", daemon=True)
            for where, send in outlets
        ]
        for thread in threads:
            thread.start()
        try:
            yield tuple(where for where, _ in outlets)
        finally:
            shown.close()
            for thread in threads:
                thread.join()


def _forward(shown: Newest[View], send: Send, where: str, say: Say) -> None:
    """Send each new picture; a failure is said once until it works again."""
    seen, number, failed = 0, 0, False
    while (news := shown.after(seen)) is not None:
        seen, message = news.number, Message.of(news.thing)
        if message is None or message.picture.number == number:
            continue
        number = message.picture.number
        try:
            send(message)
        except OSError as error:
            if not failed:
                say(f"{where}: frames do not get through ({error.strerror or error}); it is tried again with each")
            failed = True
        else:
            failed = False
