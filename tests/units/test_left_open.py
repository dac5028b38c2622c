"""Files whose writer was killed are read as far as they are whole, and damage in them is found, not waited for."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from lampest.files import hdf5
from lampest.files.checksums import is_left_open
from lampest.files.errors import InputError

VALUES = np.arange(6.0)


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """What a killed writer leaves: the bytes of a file while it is written."""
    with h5py.File(tmp_path / "growing.h5", "w", libver=hdf5.FORMAT) as file:
        values = file.create_dataset("some/values", (0,), "f8", maxshape=(None,), chunks=(4,))
        file.swmr_mode = True
        values.resize((len(VALUES),))
        values[:] = VALUES
        file.flush()
        (tmp_path / "killed.h5").write_bytes((tmp_path / "growing.h5").read_bytes())
    return tmp_path / "killed.h5"


def read(path: Path) -> np.ndarray:
    with hdf5.existing_file(path) as file:
        return np.asarray(hdf5.read_array(file, "/some/values", 1))


def test_what_a_killed_writer_left_is_read_and_stays(killed: Path) -> None:
    whole = killed.read_bytes()
    assert is_left_open(killed)
    np.testing.assert_array_equal(read(killed), VALUES)
    assert killed.read_bytes() == whole


def test_damage_in_it_is_a_sentence_that_names_it(killed: Path) -> None:
    """HDF5 alone waits for the right checksum without end."""
    whole, refused, rng = killed.read_bytes(), 0, np.random.default_rng(1)
    with h5py.File(killed.with_name("growing.h5")) as file:
        header = h5py.h5o.get_info(file["some/values"].id).addr
    for place in (9, 12, header + 6, *rng.integers(0, header + 200, 60)):
        damaged = bytearray(whole)
        damaged[place] ^= 16
        killed.write_bytes(damaged)
        try:
            np.testing.assert_array_equal(read(killed), VALUES)
        except InputError as error:
            assert str(error).startswith(str(killed))
            refused += 1
    assert refused > 10


def test_one_that_ends_too_early_is_refused_or_read(killed: Path) -> None:
    whole = killed.read_bytes()
    for length in (20, 47, 48, 300, len(whole) - 1):
        killed.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"killed\.h5"):
            read(killed)
