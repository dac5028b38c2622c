"""Import of other programs' files as recordings.

These are text tables, sheets, arrays, and layouts of one's own.
"""

from lampest.apps.foreign.arrays import Layout

LAYOUTS: tuple[Layout, ...] = ()
