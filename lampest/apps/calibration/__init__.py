"""Calibration of the circuit or of the film from recordings of known resistors or loads."""

from lampest.files.applications import Application, Command

APPLICATION = Application(
    name="calibration",
    about="numbers of a circuit or a film from known resistors or loads",
    needs=("recognition",),
    commands={
        "calibrate": Command(
            part="Board",
            target="lampest.apps.calibration.commands:calibrate",
            example="known.h5 --known known.csv --out scene.yaml",
        ),
    },
)
