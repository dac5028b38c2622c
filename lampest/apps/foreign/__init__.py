"""Import of other programs' files as recordings.

The importer reads text tables, sheets, arrays, and layouts that users register.
"""

from lampest.files.applications import Application, Command

APPLICATION = Application(
    name="foreign",
    about="recordings from other programs' files",
    commands={
        "import": Command(
            part="Begin",
            target="lampest.apps.foreign.commands:import_",
            example="mine.csv --scene scene.yaml --baseline 3 --out mine.h5",
        ),
    },
    answers={
        "a table": "lampest.apps.foreign.records:understood_table",
        "a labelled array": "lampest.apps.foreign.records:labelled_array",
        "lines as they come": "lampest.apps.foreign.line_reader:LineReader",
    },
)
