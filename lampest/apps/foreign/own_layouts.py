"""Further layouts of tables. To add one, name it in LAYOUTS."""

from lampest.apps.foreign.arrays import Layout

LAYOUTS: tuple[Layout, ...] = ()
