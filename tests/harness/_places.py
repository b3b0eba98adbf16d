"""Where tests run: no environment, home, locale or signals of the shell that started them."""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

# What finds programs, certificates and package indexes, and what is said to the tests themselves.
_KEPT = {
    "CI",
    "LD_LIBRARY_PATH",
    "LOGNAME",
    "NAMESERVICE",
    "NODE_EXTRA_CA_CERTS",
    "NO_PROXY",
    "HTTPS_PROXY",
    "HTTP_PROXY",
    "PATH",
    "REQUESTS_CA_BUNDLE",
    "SHELL",
    "SYSTEMROOT",
    "UOARM_AXE",
    "UOARM_CACHE",
    "UOARM_FOXGLOVE",
    "UOARM_MCP_CONFORMANCE",
    "UOARM_ROSBRIDGE_SUITE",
    "UOARM_ROSBRIDGE_SUITE_ROS1",
    "UOARM_ROSLIB",
    "USER",
    "VDA5050_SCHEMAS",
    "VIRTUAL_ENV",
    # Each Python that lacks it starts itself again, where wheels of ROS 2 are installed.
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
}
_KEPT_GROUPS = (
    "COVERAGE_",
    "HYPOTHESIS_",
    "NPM_CONFIG_",
    "PIP_",
    "PYENV_",
    "PYTEST_",
    "SSL_CERT_",
    "UOARM_TEST_",
    "UV_",
)
# Package managers keep their settings and what they fetched in the home that tests do not have.
_FROM_HOME = {
    "PIP_CACHE_DIR": ".cache/pip",
    "PIP_CONFIG_FILE": ".config/pip/pip.conf",
    "UV_CACHE_DIR": ".cache/uv",
    "NPM_CONFIG_CACHE": ".npm",
    "NPM_CONFIG_USERCONFIG": ".npmrc",
}


def unmeasured() -> dict[str, str]:
    """Return the environment for a process whose coverage is not measured.

    For one that has no room for that: on the disk, or on its stack.
    """
    return {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE_")}


def isolate() -> None:
    """Give this process, and all that it starts, places of its own. Call once, first of all.

    Temporary folders, pytest's own excepted, lie in one folder that goes when the process ends.
    """
    _restore_signals()
    # Pytest rewrites what it imports, the whole of uoarm included, in each worker: once is enough,
    # also where the shell says that Python keeps none of it. Workers get this from here.
    sys.dont_write_bytecode = False
    before = dict(os.environ)
    home = Path.home()
    kept = {name: value for name, value in before.items() if is_kept(name)}
    for name, place in _FROM_HOME.items():
        if (home / place).exists():
            kept.setdefault(name, str(home / place))
    kept.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
    own = Path(tempfile.mkdtemp(prefix="uoarm-", dir=kept["PYTEST_DEBUG_TEMPROOT"]))
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    for name in ("home", "t"):  # short: the path of a unix socket has about a hundred characters
        (own / name).mkdir()
    os.environ.clear()
    os.environ.update(kept, HOME=str(own / "home"), TMPDIR=str(own / "t"), LANG="C.UTF-8")
    tempfile.tempdir = None  # ask anew


def is_kept(name: str) -> bool:
    """Say whether a variable of the shell reaches the tests."""
    upper = name.upper()
    return upper in _KEPT or upper.startswith(_KEPT_GROUPS)


def _restore_signals() -> None:
    """Let children begin with the signals' defaults, also where ours are ignored, as by nohup.

    A child inherits that a signal is ignored, but no handler: so this process ignores them by one.
    """
    for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
        if signal.getsignal(number) is signal.SIG_IGN and number not in _IGNORED_BY_PYTHON:
            signal.signal(number, _ignore)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_SETMASK, ())


# `subprocess` gives children their defaults back for these.
_IGNORED_BY_PYTHON = {
    getattr(signal, name) for name in ("SIGPIPE", "SIGXFSZ", "SIGXFZ") if hasattr(signal, name)
}


def _ignore(number: int, frame: object) -> None:
    del number, frame
