"""The command `import`."""

from pathlib import Path
from typing import Annotated, Literal

from lampest.cli import screen

Lines = Annotated[int | None, screen.option(min=1)]


def import_(
    file: Path,
    out: screen.NewFile,
    rows: Lines = None,
    columns: Lines = None,
    scene: Path | None = None,
    assign: screen.AssignToScene = None,
    unit: str | None = None,
    period: screen.Amount = None,
    time_unit: Literal["s", "ms", "us"] | None = None,
    missing: str = "mark",
    baseline: Annotated[int, screen.option(min=0)] = 0,
    transpose: bool = False,
    variable: str | None = None,
    layout: str | None = None,
    resting: Path | None = None,
    skip_lines: Annotated[int, screen.option(min=0)] = 0,
) -> None:
    """Convert measurements of another program to a recording, and report how they were interpreted.

    Parameters
    ----------
    file
        CSV or other text, .xlsx, .npy, .npz, .mat, .json, .jsonl, .parquet, or a folder of frames.
    out
        New recording file.
    rows
        Rows of the panel, such as 10. Default: the scene's.
    columns
        Columns of the panel, such as 10. Default: the scene's.
    scene
        The scene's YAML file; lampest init writes one.
    unit
        ohm, kohm, volt, mV or code. Default: by header or values.
    period
        Seconds between frames, such as 0.1. Default: the file's times.
    time_unit
        Unit of the file's times. Default: by header or values.
    missing
        Missing readings: mark (NaN), skip-frame or refuse.
    baseline
        Number of unloaded frames at the beginning, such as 3.
    transpose
        Rows and columns of the file are swapped.
    variable
        The variable of a .mat or .npz file, the sheet of an .xlsx file.
    layout
        A table's columns, such as time,row,column,value, or an installed layout.
    resting
        The resting frame that firmware subtracted, for baseline: subtracted.
    skip_lines
        Lines at the beginning of a text file to leave out, such as 2.
    """
    from lampest.apps.foreign.importing import import_file
    from lampest.audit.health import Health
    from lampest.report.info import understood_lines

    agreed = screen.scene_of(scene, assign)
    replaced = out.is_file()
    with screen.progress("reading"):
        recording, notes = import_file(
            file,
            rows,
            columns,
            agreed,
            unit,
            baseline,
            transpose=transpose,
            variable=variable,
            period=period,
            missing=missing,
            layout=layout,
            time_unit=time_unit,
            resting=resting,
            skip_lines=skip_lines,
        )
        recording.save(out)
    for line in understood_lines(recording, notes):
        screen.say(screen.as_options(line))
    for line in Health.of(recording).lines:
        screen.say(line)
    screen.say(screen.written(out, replaced=replaced))
