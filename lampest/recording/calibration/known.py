"""Known resistors for a calibration: one number for all cells, or a table of them."""

from pathlib import Path

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel


def known_resistors(text: str, panel: Panel) -> Array:
    """What stands in place of the cells, (rows, columns) ohm, from a number or the name of a .csv or .npy file.

    In a file every row is a line of the panel; inf, nan or nothing between two commas stands for no resistor. Raises
    InputError where it is neither a number nor such a table.
    """
    try:
        return np.full(panel.shape, float(text))
    except ValueError:
        path = Path(text)
    try:
        if path.suffix == ".npy":
            table = np.load(path, allow_pickle=False)
        else:
            table = np.genfromtxt(path.read_text(encoding="utf-8-sig").splitlines(), delimiter=",", ndmin=2)
    except FileNotFoundError as error:
        raise InputError(f"--known: '{text}' is neither a number of ohm nor a file") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: no table of resistances ({' '.join(str(error).split())})") from error
    if not np.issubdtype(table.dtype, np.number) or np.iscomplexobj(table) or table.shape != panel.shape:
        found = " × ".join(str(size) for size in table.shape)
        raise InputError(
            f"{path}: the panel has {panel.rows} × {panel.columns} cells, but the table holds {found} numbers"
        )
    known: Array = table.astype(float)
    return known
