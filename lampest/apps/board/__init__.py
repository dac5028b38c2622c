"""Recording from boards: protocol (without I/O), serial port, stream of frames, journal, record."""

from lampest.files.applications import Application, Command

APPLICATION = Application(
    name="board",
    about="record from a board",
    needs=("foreign",),
    commands={
        "record": Command(
            part="Board",
            target="lampest.apps.board.commands:record",
            example="--out today.h5 --scene scene.yaml --baseline 3 --seconds 60",
        ),
    },
    advice="lampest.apps.board.own_estimate:board_rows",
    answers={"repair": "lampest.apps.board.commands:repaired_sentence"},
)
