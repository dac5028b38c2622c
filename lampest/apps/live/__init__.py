"""Live estimation of frames: pictures in the browser, and publication for other programs."""

from lampest.files.applications import Application, Command

APPLICATION = Application(
    name="live",
    about="show and publish estimates as frames arrive",
    needs=("board", "film", "recognition"),
    commands={
        "live": Command(
            part="Board",
            target="lampest.apps.live.commands:live",
            example="--recording example.h5 --speed 2",
        ),
    },
)
