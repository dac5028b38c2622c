"""Order in which the readings of a frame are taken."""

from typing import Any

import numpy as np

from lampest.panel.panel import Array, Numbers, Panel, Shape


def by_columns(readout: Any) -> bool:
    """Return whether a scan goes column by column; a list of readings counts as rows."""
    order = readout.noisy_side if readout.scan_order is None else readout.scan_order
    return bool(order == "columns")


def scan_places(readout: Any, rows: int, columns: int) -> Numbers:
    """Return the numbers of the readings, rows first, in scan order, (rows · columns,).

    Readings that a list leaves out are the last ones.
    """
    places = np.arange(rows * columns).reshape(rows, columns)
    if not isinstance(readout.scan_order, tuple):
        return places.T.ravel() if by_columns(readout) else places.ravel()
    row, column = np.array(readout.scan_order).T
    listed = places[row, column]
    return np.concatenate([listed, np.setdiff1d(places, listed)])


def check_scan_order(readout: Any, panel: Panel) -> None:
    """Raise ValueError unless a list of readings names every cell of a panel once."""
    order = readout.scan_order
    if not isinstance(order, tuple):
        return
    rows, columns = panel.shape
    for row, column in order:
        if not (0 <= row < rows and 0 <= column < columns):
            raise ValueError(f"readout.scan_order: there is no reading [{row}, {column}]")
    listed = set(order)
    if len(listed) < len(order):
        twice = next(at for at in order if order.count(at) > 1)
        raise ValueError(f"readout.scan_order: {list(twice)} is listed twice")
    for place in np.argwhere(panel.present).tolist():
        if tuple(place) not in listed:
            raise ValueError(f"readout.scan_order: {place} is left out")


def in_scan_order(readout: Any, values: Array) -> Array:
    """Return values (…, rows, columns) in scan order, (…, channels)."""
    places = scan_places(readout, *values.shape[-2:])
    return values.reshape(*values.shape[:-2], -1)[..., places]


def in_scan_lines(readout: Any, values: Array) -> Array:
    """Return values (…, rows, columns) in scan order by scanned lines, (…, lines, channels)."""
    rows, columns = values.shape[-2:]
    lines, channels = (columns, rows) if by_columns(readout) else (rows, columns)
    return in_scan_order(readout, values).reshape(*values.shape[:-2], lines, channels)


def of_previous_channel(readout: Any, values: Array) -> Array:
    """Return for every channel the value (…, rows, columns) of the previous one in scan order."""
    shifted = np.roll(in_scan_order(readout, values), 1, axis=-1)
    return in_panel_order(readout, shifted, values.shape)


def in_panel_order(readout: Any, channels: Array, shape: Shape) -> Array:
    """Return values (…, channels) in scan order as an array of `shape` (…, rows, columns)."""
    flat = np.empty_like(channels)
    flat[..., scan_places(readout, *shape[-2:])] = channels
    return flat.reshape(shape)
