"""Layouts of tables beside those that are recognised. To add one, name it in LAYOUTS."""

from lampest.apps.foreign.arrays import Layout

LAYOUTS: tuple[Layout, ...] = ()
