"""Recognition of loads by shapes with few parameters.

The shapes are fitted to frames and compared by their evidence.
"""

from lampest.files.applications import Application, Command

APPLICATION = Application(
    name="recognition",
    about="which load, since when, where and how strong",
    needs=("film",),
    commands={
        "detect": Command(
            part="Reconstruct",
            target="lampest.apps.recognition.commands:detect",
            example="mine.h5 --json",
        ),
    },
    scene_keys={"purpose": "builtins:str"},
    answers={
        "visits": "lampest.apps.recognition.detect.visits:export_visits",
        "a load on unloaded cells": "lampest.apps.recognition.at_rest:lies_on",
        "a load while unloaded frames were taken": "lampest.apps.recognition.at_rest:touched",
    },
)
