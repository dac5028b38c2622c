"""Maps of a panel as text: numbers, or blocks of shade for changes."""

import shutil

import numpy as np

from lampest.panel.panel import Array

MOST_ROWS = 48  # of a map
FALLS, RISES, UNKNOWN = " ░▒▓█", " .+*#", "?"
LEAST_PERCENT = 1.0  # of full shade: what readings change by from noise alone stays white
WIDTH = 100  # signs, where no terminal says how many it has


def text_map(values: Array) -> list[str]:
    """A matrix (rows, columns) as numbers, row 0 on top and columns to the right; what is cropped is said below."""
    columns = values.shape[1]
    texts = [["-" if np.isnan(value) else f"{value:.4g}" for value in row] for row in values[:MOST_ROWS]]
    width = max(len(text) for text in (*(text for row in texts for text in row), str(columns - 1))) + 2
    labels = ["column", *(f"row {row}" for row in range(len(texts)))]
    left = max(map(len, labels))
    fitting = max(1, (_room() - left) // width)
    lines = [
        f"{label:>{left}}" + "".join(f"{text:>{width}}" for text in line[:fitting])
        for label, line in zip(labels, [list(map(str, range(columns))), *texts], strict=True)
    ]
    return lines + _cropped(values, len(texts), min(fitting, columns))


def shaded_map(change: Array) -> list[str]:
    """Changes (rows, columns) in percent as shades, row 0 on top and columns to the right.

    Falls are blocks, rises signs; each reaches its full shade at the largest of its own. A cell is two signs wide where
    that leaves room for all columns, else one.
    """
    rows, columns = change.shape
    label = max(3, len(str(rows - 1)) + 1)
    wide = 2 if 2 * columns + label <= _room() else 1
    fitting = min(columns, (_room() - label) // wide)
    known = np.where(np.isfinite(change), change, 0.0)
    most = [max(float(np.max(sign * known)), LEAST_PERCENT) for sign in (-1, 1)]
    steps = [
        np.clip(np.rint(4 * part / end), 0, 4).astype(int) for part, end in zip((-known, known), most, strict=True)
    ]
    signs = np.where(steps[0] > 0, np.array(list(FALLS))[steps[0]], np.array(list(RISES))[steps[1]])
    signs = np.where(np.isfinite(change), signs, UNKNOWN)
    lines = [
        f"{row:>{label - 1}} " + "".join(wide * str(sign) for sign in line[:fitting])
        for row, line in enumerate(signs[:MOST_ROWS])
    ]
    keys = [
        f"{name} {' '.join(f'{sign} {end * part / 4:.3g} %' for part, sign in enumerate(shades) if part)}"
        for name, shades, end, sign in (("falls by", FALLS, most[0], -1), ("rises by", RISES, most[1], 1))
        if np.max(sign * known) >= LEAST_PERCENT / 8
    ]
    keys += [f"{UNKNOWN} no value"] if not np.all(np.isfinite(change)) else []
    return [
        *(line.rstrip() for line in lines),
        "; ".join(keys) or "nothing changes",
        *_cropped(change, len(lines), fitting),
    ]


def _room() -> int:
    return max(shutil.get_terminal_size((WIDTH, 24)).columns, 20)


def _cropped(values: Array, rows: int, columns: int) -> list[str]:
    if (rows, columns) == values.shape:
        return []
    return [f"(the first {rows} of {values.shape[0]} rows and {columns} of {values.shape[1]} columns)"]
