"""Advice on recordings with one effect that the scene does not name: right, wrong, or none.

    python -m docs.studies.advice [--recordings 2] [--seed 4000] [--loads LOAD...] [ROW]...

Recordings are those of `docs.studies.effects`, and of hands. A line is right if it names the effect
of the recording. `nothing` counts any line as wrong, and so do right circuits of every kind (`sound
circuits`, drawn at random).
"""

import argparse
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from docs.studies.effects import LOADS as PRESSED
from docs.studies.effects import ROWS as KNOWN
from docs.studies.effects import Load, Row, recording
from docs.studies.model_check import sound
from lampest import Recording
from lampest.audit.advice import Audit
from lampest.inference.prepared import Prepared

LOADS = {**PRESSED, "hand": Load(("hand",), swaying=0.05)}
CIRCUITS = "sound circuits"
JITTERS = "jitter"
ROWS = {
    **KNOWN,
    "contact of 60 ohm": Row(contact_ohm=60.0),
    "1 pitch a frame": Row(speed=1.0),
    "memory of 16 %": Row(memory=0.16),
}
# Keys of a scene that name the effects of a row, by the row's field.
KEYS = {
    "static": ("systematic.reading_error",),
    "channel_ohm": ("systematic.channel_spread_ohm",),
    "series_ohm": ("series_resistance_ohm", "systematic.series_tolerance_ohm"),
    "gain": ("gain",),
    "ripple_lsb": ("ripple",),
    "memory": ("converter_memory",),
    "creep": ("creep",),
    "speed": ("motion",),
    "contact_ohm": ("contacts", "systematic.channel_spread_ohm"),
}


class Advised(NamedTuple):
    """Advice on a recording.

    Attributes
    ----------
    mark : str
        The verdict.
    lines : tuple of str
        Keys that the advice names, or the finding where it names none.
    right : bool
        Whether every effect of the recording is named.
    wrong : bool
        Whether anything else is.
    """

    mark: str
    lines: tuple[str, ...]
    right: bool
    wrong: bool


def keys_of(addition: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """Yield the dotted keys of an addition."""
    for name, value in addition.items():
        if isinstance(value, Mapping):
            yield from keys_of(value, f"{before}{name}.")
        else:
            yield before + name


def expected_keys(row: Row, load: Load) -> tuple[tuple[str, ...], ...]:
    """Return the keys of each effect of a recording, of which advice may name any."""
    effects = [keys for name, keys in KEYS.items() if getattr(row, name)]
    if load.scanned and KEYS["speed"] not in effects:
        effects.append(KEYS["speed"])
    return tuple(effects)


def advised(made: Recording, expected: tuple[tuple[str, ...], ...]) -> Advised:
    """Return the advice on a recording whose effects have these keys."""
    audit = Audit(Prepared(made))
    lines = list[str]()
    for finding in audit.advice:
        lines += list(keys_of(finding.addition)) or [finding.what]
    right = all(any(key in lines for key in keys) for keys in expected)
    known = {key for keys in expected for key in keys}
    return Advised(audit.verdict.mark, tuple(lines), right, bool({*lines} - known))


def main() -> None:
    """Print a line for each row: recordings with a right line and with a wrong one, by load."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", default=[*ROWS, CIRCUITS])
    parser.add_argument("--recordings", type=int, default=2)
    parser.add_argument("--seed", type=int, default=4000)
    parser.add_argument("--loads", nargs="+", default=list(LOADS))
    parser.add_argument("--each", action="store_true", help="print a line for each recording")
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.recordings)
    print(f"| effect | {' | '.join(given.loads)} |\n|---|{'---|' * len(given.loads)}")
    for name in given.rows:
        if name == CIRCUITS:
            drawn = [
                (f"{seed}", made)
                for seed in seeds
                if (made := sound(seed, drifts=False)) is not None
            ]
            every = [(seed, advised(made, ())) for seed, (_, made) in drawn]
            print(f"| {name} | {sum(of.wrong for _, of in every)} of {len(every)} wrong |")
            for seed, of in every:
                if of.wrong or given.each:
                    print(f"{name}, {seed}: {of.mark}, {', '.join(of.lines)}", flush=True)
            continue
        entries = []
        for place in given.loads:
            load = LOADS[place]
            expected = expected_keys(ROWS[name], load)
            counts = [advised(recording(seed, load, ROWS[name], {}), expected) for seed in seeds]
            for seed, of in zip(seeds, counts, strict=True):
                if given.each or of.wrong or not of.right:
                    print(f"{name}, {place}, {seed}: {of.mark}, {', '.join(of.lines)}", flush=True)
            right = sum(of.right for of in counts) if expected else 0
            entries.append(f"{right} right, {sum(of.wrong for of in counts)} wrong")
        print(f"| {name} | {' | '.join(entries)} |", flush=True)


if __name__ == "__main__":
    main()
