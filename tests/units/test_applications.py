"""Applications of installed packages: their additions, and that a broken one costs no command."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

GOOD = """
from lampest.files.applications import Application, Command

def play(loud: bool = False) -> None:
    \"\"\"Play a note.

    Parameters
    ----------
    loud
        Whether it is loud.
    \"\"\"
    print("LOUD" if loud else "soft")

def bare(times: int = 1):
    print(times * "soft ")

def rows(recording):
    return (("music", f"{len(recording.time)} bars"),)

APPLICATION = Application(
    name="music", about="notes", advice="music:rows",
    commands={
        "play": Command(part="Play", target="music:play"),
        "music bare": Command(part="Play", target="music:bare"),
    },
)
NEEDY = Application(name="needy", about="notes of a board", needs=("organ",))
TWICE = Application(name="board", about="another board")
RUN = Application(
    name="runner", about="another run", commands={"run": Command(part="Play", target="music:play")}
)
LOST = Application(
    name="lost", about="no such note", commands={"lost": Command(part="Play", target="music:lost")}
)
"""


def lampest(folder: Path, *words: str) -> tuple[int, str, str]:
    """The exit code, the output and the messages of a command, with the packages of a folder."""
    script = [sys.executable, "-c", "from lampest.cli import main; main()", *words]
    paths = os.pathsep.join((str(folder), *filter(None, [os.environ.get("PYTHONPATH")])))
    environment = os.environ | {"PYTHONPATH": paths}
    completed = subprocess.run(script, env=environment, capture_output=True, text=True)
    return completed.returncode, completed.stdout, completed.stderr


def install(folder: Path, points: str) -> None:
    """Put a package with entry points into a folder, as an installer does."""
    (folder / "music.py").write_text(GOOD)
    about = folder / "music-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: music\nVersion: 1\n")
    (about / "entry_points.txt").write_text(f"[lampest.applications]\n{points}\n")


@pytest.mark.slow
def test_an_installed_application_adds_commands_and_lines(tmp_path: Path) -> None:
    install(tmp_path, "music = music:APPLICATION")
    assert lampest(tmp_path, "play", "--loud") == (0, "LOUD\n", "")
    assert lampest(tmp_path, "music", "bare", "--times", "2") == (0, "soft soft \n", "")
    data = Path(__file__).parents[2] / "data" / "ring.h5"
    code, out, message = lampest(tmp_path, "info", str(data))
    assert (code, message) == (0, "") and "\nmusic      " in out and " bars\n" in out


@pytest.mark.long
@pytest.mark.parametrize(
    ("point", "objection"),
    [
        ("missing = nowhere:APPLICATION", "cannot be loaded (No module named 'nowhere')"),
        ("number = music:GOOD", "cannot be loaded"),
        ("function = music:play", "is no Application"),
        ("needy = music:NEEDY", "the application 'needy' needs organ"),
        ("twice = music:TWICE", "there is an application 'board' already"),
        ("run = music:RUN", "the application 'runner': there is a command 'run' already"),
        ("lost = music:LOST", "the command 'lost' cannot be loaded"),
    ],
)
def test_a_broken_application_is_named_and_costs_no_command(
    point: str, objection: str, tmp_path: Path
) -> None:
    install(tmp_path, f"music = music:APPLICATION\n{point}")
    code, out, message = lampest(tmp_path, "play")
    assert (code, out) == (0, "soft\n")
    assert objection in message and message.count("\n") == 1
