"""Small files that expand, and scenes that need more memory than a machine has."""

import struct
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from attack.attack import (
    PASSED,
    CompletedCommand,
    Outcomes,
    Rng,
    attack,
    command,
    environment,
    small_folder,
)
from fuzz.mutants import good_recordings

from lampest.files import process

pytestmark = pytest.mark.slow
TOO_FEW_ADDRESSES = "not enough memory", "of addresses are needed", "ulimit -v"
JOBS = "run", "run.yaml", "--jobs", "2", "--out", "out"
# of a command; with its libraries it has 150, and machines have other things to do
MEGABYTES = 900
SECONDS = 60
WIDE_SCENE = "panel: {rows: 1, columns: 60001}\nreadout: {kind: two_point, noise_lsb: 0.7}\n"
TABLE = ("--rows", "3", "--columns", "4", "--out", "out.h5")


@attack()
def test_a_file_that_repeats_a_long_text_is_refused(rng: Rng, folder: Path, count: int) -> Outcomes:
    path = folder / "small.h5"
    path.write_bytes(good_recordings(folder)[0])
    with h5py.File(path, "a") as file:
        group = file["entry/acquisition"]
        del group["event_label"], group["event_time"]
        texts = group.create_dataset("event_label", (20_000,), h5py.string_dtype())
        texts[0] = "x" * 300_000
        group["event_time"] = np.zeros(20_000)
    content = bytearray(path.read_bytes())
    place = _place(content, 300_000)
    reference = bytes(content[place : place + 16])
    content[place : place + 16 * 20_000] = reference * 20_000
    path.write_bytes(content)
    yield _bounded(command("info", "small.h5", folder=folder, seconds=SECONDS), "small.h5")


def _place(content: bytearray, length: int) -> int:
    """Where the first reference to a text of that length stands, 19 999 empty ones behind it."""
    place = content.find(struct.pack("<I", length))
    while any(content[place + 16 : place + 160]):
        place = content.find(struct.pack("<I", length), place + 1)
        assert place > 0
    return place


def _matrix(path: Path) -> None:
    """A compressed .mat file of 390 MB."""
    values = 390_000_000 // 12 * 12
    head = struct.pack(
        "<IIIIIIiiiiIIII", 6, 8, 9, 0, 5, 12, values // 12, 3, 4, 0, 1, 1, ord("a"), 0
    )
    head += struct.pack("<II", 2, values)
    packer = zlib.compressobj(9)
    packed = packer.compress(struct.pack("<II", 14, len(head) + values) + head)
    packed += (
        b"".join(packer.compress(bytes(1_000_000)) for _ in range(values // 1_000_000 + 1))
        + packer.flush()
    )
    start = b"MATLAB 5.0".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    path.write_bytes(start + struct.pack("<II", 15, len(packed)) + packed)


IMPORTED = {
    "bomb.mat": _matrix,
    "bomb.npz": lambda path: np.savez_compressed(
        path, a=np.zeros((40_000_000, 3, 4), dtype=np.uint8)
    ),
    "lines.csv": lambda path: path.write_bytes(b"\n" * 200_000_000),
}


@attack(len(IMPORTED), len(IMPORTED))
def test_small_files_that_expand_are_not_imported(rng: Rng, folder: Path, count: int) -> Outcomes:
    for name, write in IMPORTED.items():
        write(folder / name)
        yield _bounded(command("import", name, *TABLE, folder=folder, seconds=SECONDS), name)


@attack()
def test_panels_of_1_by_60001_cells_are_refused_for_lack_of_memory(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    work_folder = small_folder(folder / "work")
    scene = "\n".join(f"  {line}" for line in WIDE_SCENE.splitlines())
    (work_folder / "wide.yaml").write_text(
        f"schema: 1\nseed: 1\nframes: 1\nbaseline_frames: 1\nscene:\n{scene}\n"
    )
    with h5py.File(work_folder / "wide.h5", "w") as file:
        file["entry/scene"] = np.bytes_(WIDE_SCENE)
        file["entry/two_point/resistance"] = np.full((2, 1, 60001), 1500.0)
        file["entry/two_point/role"] = np.array([0, 1], dtype=np.uint8)
    run = (work_folder / "run.yaml").read_text()
    (work_folder / "run.yaml").write_text(run.replace("small.h5", "wide.h5"))
    for arguments in (("simulate", "wide.yaml"), ("calibrate", "wide.h5", "--known", "1000")):
        completed = command(*arguments, folder=work_folder, seconds=SECONDS, memory="4GB")
        yield _bounded(completed, "60001", "GiB of memory are needed", "there are 4.0 GiB")
    looked = command("info", "wide.h5", folder=work_folder, seconds=SECONDS, memory="4GB")
    yield (
        looked.within(SECONDS, MEGABYTES)
        if looked.code == 0
        else looked.described("a look at a wide panel")
    )
    completed = command(
        *("run", "run.yaml", "--out", "out", "--jobs", "1"),
        folder=work_folder,
        seconds=SECONDS,
        memory="4GB",
    )
    yield _bounded(completed, "60001", "GiB of memory are needed", "there are 4.0 GiB")


def _bounded(completed: CompletedCommand, *words: str) -> str:
    return completed.refused(*words) or completed.within(SECONDS, MEGABYTES) or PASSED


@attack(2, 40)
def test_a_tight_address_limit_gives_one_sentence_without_waiting(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    """Under a limit lampest loads no library that would raise KeyError, wait or end the process."""
    work_folder = small_folder(folder / "work")
    commands = (("info", "small.h5"), JOBS, ("plot", "results.h5"))
    for number in range(count):
        limit = int(rng.integers(100, 900)) * 2**20
        completed = _within_addresses(limit, *commands[number % 3], folder=work_folder)
        sufficient = limit >= process.ADDRESS_SPACE
        yield completed.survived() if sufficient else completed.refused(*TOO_FEW_ADDRESSES)


def _within_addresses(limit: int, *arguments: str, folder: Path) -> CompletedCommand:
    """Run the command under a limit of addresses in bytes."""
    script = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))\n"
    words = [sys.executable, "-c", f"{script}from lampest.cli import main; main()", *arguments]
    completed = subprocess.run(
        words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=SECONDS
    )
    return CompletedCommand(completed.returncode, completed.stdout, completed.stderr, 0.0, 0)


FILLED = """
import re, resource
from pathlib import Path
from lampest import Misfit, Panel, Recording, reconstruct, two_point_resistance
from lampest.files.process import check_address_space
import numpy as np

resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))
check_address_space()
cells = np.random.default_rng(1).uniform(900, 2000, (2, 6, 7))
recording = Recording.from_array(two_point_resistance(cells), baseline=1)
corner = Recording.from_array(recording.resistance[:, :1, :2], baseline=1)
reconstruct(corner, [Misfit()], formulation="reduced")
taken = 1024 * int(re.search(r"VmSize:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
resource.setrlimit(resource.RLIMIT_AS, (taken + 50 * 2**20,) * 2)
print(reconstruct(recording, [Misfit()], formulation="nodal").status[0])
"""


def test_ipopt_needs_no_further_buffer_when_data_filled_the_addresses() -> None:
    """OpenBLAS asks for ever for the 128 MiB that it is refused."""
    completed = subprocess.run(
        [sys.executable, "-c", FILLED],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (completed.returncode, completed.stdout, completed.stderr) == (
        0,
        "local optimum verified\n",
        "",
    )
