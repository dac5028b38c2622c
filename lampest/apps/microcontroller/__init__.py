"""Estimators for microcontrollers: constants of the C library `lampest_estimate`, and budgets."""

from lampest.files.applications import Application

APPLICATION = Application(
    name="microcontroller",
    about="estimate on a microcontroller",
    answers={"sketch": "lampest.apps.microcontroller.commands:export_to_c"},
)
