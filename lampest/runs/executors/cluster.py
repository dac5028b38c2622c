"""What a Dask cluster elsewhere is told: files for an encrypted connection, and the jobs of SLURM."""

import re
import shlex
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from lampest.files.errors import InputError
from lampest.runs.executors.executor import ONE_THREAD, check_workers

WORD = r"[A-Za-z0-9_.:,@%+/=-]+"
LOCAL = "jobqueue.slurm.local-directory"


@dataclass(frozen=True)
class Tls:
    """Files by which all sides of a cluster know each other; without them whoever reaches a scheduler runs code on it.

    Parameters
    ----------
    ca_file : the authority that signed the certificates of all sides, PEM.
    cert_file, key_file : the certificate of this side and its key, PEM.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    ca_file: str
    cert_file: str
    key_file: str

    def beside(self, folder: Path) -> "Tls":
        """The same with paths from that folder on. Raises InputError where a file cannot be read."""
        files = {name: folder / getattr(self, name) for name in ("ca_file", "cert_file", "key_file")}
        for name, path in files.items():
            try:
                path.open("rb").close()
            except OSError as error:
                raise InputError(f"executor.tls.{name}: {path}: cannot be read ({error.strerror})") from error
        return Tls(**{name: str(path.absolute()) for name, path in files.items()})

    def security(self, in_jobs: bool = False) -> Any:
        """What Dask takes: the files for every side, and an encrypted connection or none.

        in_jobs : workers are jobs, in whose scripts their files stand, quoted.
        """
        base = cluster_module("distributed.security").Security

        def quoted(security: Any, role: str) -> Any:
            files = base.get_tls_config_for_role(security, role)
            return {name: shlex.quote(file) for name, file in files.items()} if role == "worker" else files

        kind: Any = type("QuotedSecurity", (base,), {"get_tls_config_for_role": quoted}) if in_jobs else base
        sides = {f"tls_{side}_{part}" for side in ("client", "scheduler", "worker") for part in ("cert", "key")}
        own = {name: self.cert_file if name.endswith("cert") else self.key_file for name in sides}
        return kind(tls_ca_file=self.ca_file, require_encryption=True, **own)


@dataclass(frozen=True)
class Slurm:
    """What a SLURM job asks for.

    Parameters
    ----------
    queue, account : partition and account, or the site's defaults.
    walltime : longest time of one job, HH:MM:SS; a job that ends is replaced while tasks are left.
    workers_per_job : processes of one core each in one job.
    memory : of one job, such as 4GB.
    interface : network interface of workers and scheduler, such as ib0.
    directives : further #SBATCH lines, such as --constraint=avx2. prologue : shell lines before the workers start;
    these two are written as they are.

    Raises ValueError where a number is out of range, or a word of the job is none.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    queue: str | None = None
    account: str | None = None
    walltime: str = "01:00:00"
    workers_per_job: int = 1
    memory: str = "2GB"
    interface: str | None = None
    directives: tuple[str, ...] = ()
    prologue: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_workers(self.workers_per_job)
        for name in ("queue", "account", "walltime", "memory", "interface"):
            word = getattr(self, name)
            if word is not None and not re.fullmatch(WORD, word):
                raise ValueError(f"slurm.{name} is {word!r}; it must be one word")

    def cluster(self, tls: Tls | None = None) -> Any:
        """A cluster of jobs without any job yet; every path in their scripts is quoted. Raises InputError without
        dask-jobqueue.
        """
        exports = [f"export {name}={value}" for name, value in ONE_THREAD.items()]
        jobqueue, local = cluster_module("dask_jobqueue"), cluster_module("dask").config.get(LOCAL, None)
        return jobqueue.SLURMCluster(
            python=shlex.quote(sys.executable),
            local_directory=None if local is None else shlex.quote(str(local)),
            security=None if tls is None else tls.security(in_jobs=True),
            protocol=None if tls is None else "tls://",
            queue=self.queue,
            account=self.account,
            walltime=self.walltime,
            cores=self.workers_per_job,
            processes=self.workers_per_job,
            memory=self.memory,
            interface=self.interface,
            job_extra_directives=list(self.directives),
            job_script_prologue=[*self.prologue, *exports],
            scheduler_options={"dashboard": False, "dashboard_address": ":0"},
        )


def cluster_module(name: str) -> Any:
    """A library of the extra, imported where it is used. Raises InputError where it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            f"executor: dask needs {name.replace('_', '-')}, which is not installed; it comes with the extra: "
            "pip install 'lampest[cluster]'"
        ) from error
