"""`lampest export --to c`."""

from pathlib import Path

from lampest.cli import screen


def export_to_c(
    results: Path,
    out: Path | None,
    recording: str | None,
    estimator: str | None,
    wishes: tuple[float | None, float | None, str | None],
) -> None:
    """Write a sketch for a microcontroller, and print what budgets buy."""
    from lampest.apps.microcontroller.sketch import Wishes, export_sketch
    from lampest.apps.microcontroller.trade import table_of

    sketch = export_sketch(results, out, recording, estimator, Wishes(*wishes))
    for line in sketch.about:
        screen.say(line)
    if sketch.table:
        screen.print_table(table_of(sketch.table))
    screen.print_notes(sketch.notes)
    for path in sketch.files:
        screen.say(path)
