"""Who can reach a Dask cluster: this computer alone, or whoever has the files; and what jobs make of odd paths."""

import shlex
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lampest.files.errors import InputError
from lampest.runs.config import read_run
from lampest.runs.executors import Dask, Slurm, Tls

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


def test_a_scheduler_with_certificates_is_used_and_one_without_the_files_is_not(
    keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import distributed

    tls = tls_of(keys)
    options: Any = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0", "host": "tls://127.0.0.1"}
    with distributed.LocalCluster(**options, protocol="tls://", security=tls.security()) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        assert list(Dask(address=address, tls=tls).results(eval, ["6 * 7"])) == [("6 * 7", 42)]
        monkeypatch.setattr("lampest.runs.executors.dask.PATIENCE_S", 1)
        with pytest.raises(InputError, match="no Dask scheduler with workers answers"):
            list(Dask(address=address.replace("tls", "tcp")).results(eval, ["1"]))


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


@pytest.mark.parametrize("name", ["queue", "account", "walltime", "memory", "interface"])
@pytest.mark.parametrize("word", ["", "a b", "a\nrm -rf /", "$(id)", "`id`", "a;b", "a'b"])
def test_words_of_a_job_are_words(name: str, word: str) -> None:
    with pytest.raises(ValueError, match=rf"slurm\.{name} is .*; it must be one word"):
        Slurm(**{name: word})


def test_job_scripts_quote_every_path(keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import dask
    import dask_jobqueue  # noqa: F401  (its defaults come with it, and would go with what is set here)

    python = tmp_path / "my venv; touch x" / "python"
    scratch = tmp_path / "scratch of 'mine'"
    monkeypatch.setattr(sys, "executable", str(python))
    with dask.config.set({"jobqueue.slurm.local-directory": str(scratch)}), Slurm().cluster(tls_of(keys)) as cluster:
        script = cluster.job_script()
    words = shlex.split(script.splitlines()[-1])
    assert words[:3] == [str(python), "-m", "distributed.cli.dask_worker"]
    told = dict(pairwise(words))
    assert told["--local-directory"] == str(scratch)
    assert [told[f"--tls-{name}"] for name in ("ca-file", "cert", "key")] == [
        str(keys / name) for name in ("ca.pem", "me.pem", "me.key")
    ]
    assert words[3].startswith("tls://")
