"""Pytest plugin that records the duration of each passed test and the functions that it calls."""

import json
import os
import sys
import threading
import time
from collections.abc import Generator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

OUTPUT = "LAMPEST_MUTATION_RECORD"  # environment variable: the file to write


class Recorder:
    """Functions called by each test.

    Attributes
    ----------
    package : folder of the package.
    codes : function by the identity of its code object, which stays alive here.
    called : identities since the last test began.
    tests : per test its seconds, whether it passed and the functions, "path:qualified name".
    """

    def __init__(self, package: Path) -> None:
        self.package = str(package)
        self.codes: dict[int, CodeType] = {}
        self.called: set[int] = set()
        self.tests: dict[str, dict[str, Any]] = {}

    def trace(self, frame: FrameType, event: str, argument: object) -> None:
        """Record a call; no line of it is traced."""
        self.codes.setdefault(id(frame.f_code), frame.f_code)
        self.called.add(id(frame.f_code))

    def functions(self) -> list[str]:
        """Return the functions of the package that were called."""
        codes = [self.codes[key] for key in self.called]
        inside = [code for code in codes if code.co_filename.startswith(self.package)]
        return sorted(
            {f"{code.co_filename[len(self.package) + 1 :]}:{code.co_qualname}" for code in inside}
        )

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Trace one test with its fixtures."""
        self.called = set()
        threading.settrace(self.trace)
        sys.settrace(self.trace)
        begin = time.perf_counter()
        done = yield
        sys.settrace(None)
        self.tests.setdefault(item.nodeid, {"passed": True})
        self.tests[item.nodeid] |= {
            "seconds": time.perf_counter() - begin,
            "functions": self.functions(),
        }
        return done

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that fails or is skipped: it guards nothing."""
        if not report.passed:
            self.tests.setdefault(report.nodeid, {})["passed"] = False

    def pytest_sessionfinish(self) -> None:
        """Write this process's part of the record."""
        worker = os.environ.get("PYTEST_XDIST_WORKER", "main")
        passed = {
            name: test
            for name, test in self.tests.items()
            if test.get("passed") and "functions" in test
        }
        Path(f"{os.environ[OUTPUT]}.{worker}").write_text(json.dumps(passed))


def pytest_configure(config: pytest.Config) -> None:
    """Install the recorder in every process that runs tests."""
    config.pluginmanager.register(Recorder(config.rootpath / "lampest"), "mutation-recorder")
