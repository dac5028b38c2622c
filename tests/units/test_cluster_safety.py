"""Who can reach a Dask cluster: this computer alone, or whoever has the files."""

import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lampest.files.errors import InputError
from lampest.runs.config import read_run
from lampest.runs.executors import Dask, Tls

# Of a worker: whether every process of its cluster listens on the loopback address alone.
LISTENING = (
    "{c.laddr.ip for p in (lambda top: [top, *top.children(recursive=True)])"
    "(__import__('psutil').Process().parent().parent()) for c in p.net_connections('inet') if c.status == 'LISTEN'}"
)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder, with a blank and quotes in its name, with an authority's certificate and one that it signed."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificates")
    folder = tmp_path_factory.mktemp("it's mine")
    for words in (
        "req -x509 -newkey rsa:2048 -nodes -keyout ca.key -out ca.pem -days 2 -subj /CN=authority",
        "req -newkey rsa:2048 -nodes -keyout me.key -out me.csr -subj /CN=me",
        "x509 -req -in me.csr -CA ca.pem -CAkey ca.key -CAcreateserial -out me.pem -days 2",
    ):
        subprocess.run(["openssl", *words.split()], cwd=folder, check=True, capture_output=True)
    return folder


def tls_of(folder: Path) -> Tls:
    return Tls("ca.pem", "me.pem", "me.key").beside(folder)


def test_a_cluster_of_this_machine_listens_on_the_loopback_address_alone() -> None:
    [(_, found)] = Dask(workers=1).results(eval, [LISTENING])
    assert found == {"127.0.0.1"}


def test_a_scheduler_with_certificates_is_used_and_one_without_the_files_is_not(keys: Path) -> None:
    import distributed

    tls = tls_of(keys)
    options: Any = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0", "host": "tls://127.0.0.1"}
    own = {
        f"tls_{side}_{part}": file
        for side in ("client", "scheduler", "worker")
        for part, file in (("cert", tls.cert_file), ("key", tls.key_file))
    }
    every_side = distributed.Security(tls_ca_file=tls.ca_file, require_encryption=True, **own)
    with distributed.LocalCluster(**options, protocol="tls://", security=every_side) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        assert list(Dask(address=address, tls=tls).results(eval, ["6 * 7"])) == [("6 * 7", 42)]
        with pytest.raises(InputError, match="no Dask scheduler with workers answers"):
            list(Dask(address=address.replace("tls", "tcp"), wait_s=1.0).results(eval, ["1"]))


def test_files_are_taken_from_beside_the_run(disk: SimpleNamespace, keys: Path) -> None:
    for name in ("ca.pem", "me.pem", "me.key"):
        shutil.copy(keys / name, disk.folder)
    entry = (
        "executor: {kind: dask, address: 'tls://a:1', tls: {ca_file: ca.pem, cert_file: me.pem, key_file: me.key}}\n"
    )
    run = read_run(disk.run(disk.text + entry))
    assert run.executor == Dask(address="tls://a:1", tls=tls_of(disk.folder))
    (disk.folder / "me.key").unlink()
    with pytest.raises(InputError, match=r"executor\.tls\.key_file: .*me\.key: cannot be read \(No such file"):
        read_run(disk.run(disk.text + entry))


def test_a_device_is_no_scheduler_file(disk: SimpleNamespace) -> None:
    with pytest.raises(InputError, match=r"executor\.scheduler_file: /dev/zero: is no regular file"):
        read_run(disk.run(disk.text + "executor: {kind: dask, scheduler_file: /dev/zero}\n"))


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"address": "tls://a:1"}, "tls goes with an address that begins with tls://"),
        ({"address": "tcp://a:1", "tls": Tls("a", "b", "c")}, "tls goes with an address that begins with tls://"),
        ({"tls": Tls("a", "b", "c")}, "listen on its loopback address alone, without tls"),
    ],
)
def test_what_does_not_go_together(given: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Dask(**given).ready()
