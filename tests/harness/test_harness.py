"""The harness catches what it is for: leaks, hangs, slow tests, order, what a shell hands down."""

from __future__ import annotations

import asyncio
import gc
import json
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from unittest.mock import Mock

import pytest
import xdist.plugin
from tests import tiers
from tests.harness import ORDER, SPARE_WORKERS, Scheduler, _places
from tests.harness._delays import DELAYS
from tests.harness._leaks import maker, variables_of
from tests.harness._needs import MODULES, NEEDS
from tests.processes import run_program, run_python
from tests.tiers import BY_DEFAULT, NAMES, TIERS, Tier, run_all
from xdist.remote import Producer

from uoarm.testing import patience

ROOT = Path(__file__).parents[2]
Run = Callable[..., "pytest.RunResult"]


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a module of tests under the harness, in a process of its own."""

    def begin(tests: str, *options: str, set_up: str = "", **environment: str) -> pytest.RunResult:
        pytester.makepyfile(tests)
        pytester.makeconftest(f"import tests.harness as harness\n{set_up}\n")
        pytester.makeini("[pytest]\nfilterwarnings = error")
        for name in ("CI", ORDER, DELAYS):
            monkeypatch.delenv(name, raising=False)
        for name, value in {"PYTHONPATH": str(ROOT), **environment}.items():
            monkeypatch.setenv(name, value)
        given = ("-p", "tests.harness", "-p", "no:cacheprovider", *options)
        return pytester.runpytest_subprocess(*given)

    return begin


TESTS: dict[str, str] = {}
"""What can run in one process: the start of a run costs more than most of its tests."""
SET_UP = """
import tests.harness as harness
from tests.harness import _leaks

harness.LONG_SECONDS, harness.LONG_LOOK_SECONDS = 0.3, 0.0
_leaks.patience = lambda: 1.0
"""


class Ran:
    """What a run of all the modules printed; its outcomes can be asked for by module."""

    def __init__(self, printed: str) -> None:
        self.printed = pytest.LineMatcher(printed.splitlines())

    def outcomes(self, module: str) -> dict[str, int]:
        line = re.compile(rf"test_{module}\.py::.* (PASSED|FAILED|ERROR|SKIPPED)\b")
        return Counter(found[1].lower() for found in map(line.match, self.printed.lines) if found)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    place = tmp_path_factory.mktemp("modules")
    files = {f"test_{name}.py": dedent(tests) for name, tests in TESTS.items()}
    files |= {"conftest.py": SET_UP, "pytest.ini": "[pytest]\nfilterwarnings = error"}
    for name, text in files.items():
        (place / name).write_text(text, encoding="utf-8")
    unset = ("CI", ORDER, DELAYS, "HYPOTHESIS_PROFILE")
    without = ["env", *(f"--unset={name}" for name in unset), sys.executable]
    given = ("-m", "pytest", "-v", "-ra", "-p", "tests.harness", "-p", "no:cacheprovider")
    done = run_program(*without, *given, cwd=place, env={"PYTHONPATH": str(ROOT)})
    return Ran(done.stdout)


TESTS["coroutines"] = """
    import asyncio

    async def test_right(tmp_path):
        await asyncio.sleep(0)

    async def test_wrong():
        await asyncio.sleep(0)
        assert False, "it ran"
"""


def test_a_test_that_is_a_coroutine_runs_in_a_loop_of_its_own(ran: Ran) -> None:
    assert ran.outcomes("coroutines") == {"passed": 1, "failed": 1}
    ran.printed.fnmatch_lines(["*AssertionError: it ran*"])


LEAKS = {
    "threading.Thread(target=threading.Event().wait, name='stray', daemon=True).start()": (
        "thread 'stray'"
    ),
    "subprocess.Popen(['sleep', '1000']).returncode = 0": "process *: sleep 1000",
    "subprocess.run('sleep 1000 & sleep 1000 & exit', shell=True)": "process *: sleep 1000",
    "subprocess.run([sys.executable, '-c', daemon])": "process *: sleep 1000",
    "os.system('sleep 1000 &')": "process *: sleep 1000",
    "os.fork() or os.execlp('sleep', 'sleep', '1000')": "process *: sleep 1000",
    "os.posix_spawnp('sleep', ['sleep', '1000'], os.environ)": "process *: sleep 1000",
    "kept.append(socket.socket())": "descriptor of socket:*",
    "os.pipe()": "descriptor of pipe:*",
    "tempfile.mkdtemp(prefix='stray')": "temporary *stray*",
    "os.environ['STRAY'] = 'yes'": "$STRAY changed from None to 'yes'",
    "os.chdir('/')": "the working directory changed*",
    "signal.signal(signal.SIGTERM, signal.SIG_IGN)": "the handler of SIGTERM changed*",
    "locale.setlocale(locale.LC_ALL, 'C')": "the locale changed*",
}
TESTS["leaking"] = f"""
    import locale, os, signal, socket, subprocess, sys, tempfile, threading
    import pytest

    kept = []
    daemon = "import subprocess; subprocess.Popen(['sleep', '1000'], start_new_session=True)"

    def test_before():
        pass

    @pytest.mark.parametrize("number, leak", {[*enumerate(LEAKS)]!r})
    def test_leaking(number, leak):
        exec(leak)

    def test_after():
        pass
"""


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="only Linux shows them")
def test_a_leak_fails_the_test_that_made_it_by_name(ran: Ran) -> None:
    assert ran.outcomes("leaking") == {"passed": len(LEAKS) + 2, "error": len(LEAKS)}
    for number, says in enumerate(LEAKS.values()):
        ran.printed.fnmatch_lines([f"*test_leaking?{number}-* left behind:", f"*{says}*"])
    ran.printed.no_fnmatch_line("*processes left behind*")


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="only Linux shows them")
def test_the_maker_of_a_process_is_known_as_soon_as_it_is_started() -> None:
    for _ in range(300):
        with maker("a start"), subprocess.Popen(["sleep", "1000"]) as process:
            found = variables_of(Path("/proc", str(process.pid)))
            process.kill()
        assert b"a start" in found


TESTS["holding"] = """
    import subprocess, threading
    import pytest

    @pytest.fixture(scope="module")
    def held():
        go = threading.Event()
        thread = threading.Thread(target=go.wait)
        thread.start()
        with subprocess.Popen(["sleep", "1000"]) as process:
            yield
            process.kill()
        go.set()
        thread.join()

    def test_one(held):
        pass

    def test_two(held):
        pass
"""


def test_what_a_fixture_of_several_tests_holds_is_no_leak(ran: Ran) -> None:
    assert ran.outcomes("holding") == {"passed": 2}


TESTS["replaced"] = """
    import threading
    import pytest

    @pytest.fixture(scope="module")
    def held():
        gates = [threading.Event()]
        threading.Thread(target=gates[0].wait, name="reads").start()
        yield gates
        for gate in gates:
            gate.set()

    @pytest.mark.parametrize("count", [1, 2])
    def test_replaced(held, count):
        held[-1].set()
        for _ in range(count):
            held.append(threading.Event())
            threading.Thread(target=held[-1].wait, name="reads").start()

    def test_after(held):
        pass
"""


def test_a_thread_that_takes_the_place_of_one_of_its_name_is_no_leak_and_two_are(ran: Ran) -> None:
    assert ran.outcomes("replaced") == {"passed": 3, "error": 1}
    ran.printed.fnmatch_lines(["*test_replaced?2? left behind:", "thread 'reads'"])


def test_a_process_that_outlives_the_run_fails_the_run_and_is_ended(run: Run) -> None:
    found = run("""
        import subprocess
        import pytest

        @pytest.fixture(scope="session")
        def held():
            subprocess.Popen(["sleep", "1000"]).returncode = 0

        def test_one(held):
            pass
    """)
    found.assert_outcomes(passed=1)
    assert found.ret == pytest.ExitCode.TESTS_FAILED
    found.stdout.fnmatch_lines(["processes left behind by this run: *sleep 1000*"])


def test_a_test_that_hangs_is_ended_and_says_where(run: Run) -> None:
    found = run(
        """
        import threading
        import pytest

        def test_hanging():
            threading.Event().wait()

        @pytest.mark.timeout(0)  # it may be late
        def test_after():
            pass
        """,
        set_up="harness.HANGING = 0.01",
        UOARM_TEST_SLOWNESS="1",
    )
    found.assert_outcomes(failed=1, passed=1)
    found.stdout.fnmatch_lines(["*threading.Event().wait()", "*Timeout (>0.6s)*"])


TESTS["long"] = """
    import time
    import pytest

    def work():
        end = time.process_time() + 0.5
        while time.process_time() < end:
            pass

    def test_slow():
        work()

    @pytest.mark.long
    def test_long():
        work()

    def test_that_waits():
        time.sleep(0.6)
"""


def test_a_test_that_works_too_long_fails_however_fast_the_machine(ran: Ran) -> None:
    assert ran.outcomes("long") == {"failed": 1, "passed": 2}
    ran.printed.fnmatch_lines(["*s of processor time: make it less, or mark it long"])


def test_at_length_a_property_may_work_for_long(run: Run) -> None:
    result = run(
        dedent(TESTS["long"]), set_up="harness.LONG_SECONDS = 0.3", HYPOTHESIS_PROFILE="long"
    )
    result.assert_outcomes(passed=3)


def test_a_step_takes_what_is_done_in_it_without_collections(
    longest_step: Callable[[str], float],
) -> None:
    kept = [[number] for number in range(200_000)]
    collections: list[float] = []

    def collect() -> None:
        begin = time.thread_time()
        gc.collect()
        collections.append(time.thread_time() - begin)

    def work() -> None:
        end = time.thread_time() + 2 * collections[0]
        while time.thread_time() < end:
            pass

    longest: list[float] = []

    async def steps() -> None:
        for step in (collect, work):
            asyncio.get_running_loop().call_soon(step)
            await asyncio.sleep(0)
            longest.append(longest_step("steps"))

    thread = threading.Thread(target=lambda: asyncio.run(steps()), name="steps")
    thread.start()
    thread.join(patience())
    assert longest[0] < collections[0] / 2
    assert longest[1] >= 2 * collections[0]
    assert len(kept) == 200_000


ORDERED = """
    import pytest

    made = []

    @pytest.mark.parametrize("number", range(8))
    def test_in_order(number):
        made.append(number)
        assert made == [*range(number + 1)]
"""


def test_another_order_finds_a_test_that_depends_on_it_but_those_of_a_scene_keep_theirs(
    pytester: pytest.Pytester, run: Run
) -> None:
    pytester.makepyfile(test_scene=ORDERED)
    found = run(ORDERED, "-v", set_up="harness.TOGETHER.add('test_scene.py')", UOARM_TEST_ORDER="4")
    assert found.parseoutcomes()["failed"]
    found.stdout.fnmatch_lines([f"test_scene.py::*{number}? PASSED*" for number in range(8)])
    found.stdout.no_fnmatch_line("FAILED test_scene.py*")


LATE = """
import json, queue, sys, threading
from types import SimpleNamespace
sys.path.insert(0, sys.argv[1])
import _delays

before = threading.Thread.run, threading.Condition.wait, queue.SimpleQueue
_delays.begin()
slept = []
_delays.time = SimpleNamespace(sleep=slept.append)
measured = []
waits, items, ran = threading.Condition(), queue.SimpleQueue(), []
with waits:
    for _ in range(100):
        waits.wait(0)
measured.append(slept.copy())
slept.clear()
for number in range(100):
    items.put(number)
    assert items.get() == number
measured.append(slept.copy())
slept.clear()
for number in range(100):
    threading.Thread.run(threading.Thread(target=ran.append, args=[number]))
assert ran == list(range(100))
measured.append(slept)
is_same = before == (threading.Thread.run, threading.Condition.wait, queue.SimpleQueue)
print(json.dumps([is_same, measured]))
"""


TESTS["kept"] = """
    import gc

    kept = []

    def test_that_keeps():
        gc.unfreeze()
        kept.append([])
        gc.collect()
        assert any(value is kept for value in gc.get_objects())

    def test_after():
        assert not any(value is kept or value is kept[0] for value in gc.get_objects())
"""


def test_what_is_let_go_or_kept_is_left_out_of_later_looks_at_everything(ran: Ran) -> None:
    assert ran.outcomes("kept") == {"passed": 2}


def test_threads_begin_late_and_one_of_four_waits_ends_late_by_a_number() -> None:
    def late(number: str) -> tuple[bool, list[list[float]]]:
        command = [sys.executable, "-c", LATE, str(Path(__file__).parent)]
        out = subprocess.run(
            command,
            env={DELAYS: number},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
            timeout=2 * patience(),
        ).stdout
        is_same, output = json.loads(out)
        return is_same, output

    assert late("") == (True, [[], [], []])
    is_same, (waits, gets, begins) = late("1")
    assert not is_same
    assert 10 < len(waits) < 40
    assert 10 < len(gets) < 40
    assert len(begins) == 100
    usual = sorted(begins)[:-10]  # of each hundred a few are twenty times as long
    assert 0.04 < max(usual) <= 0.05 < max(begins) <= 1.0
    assert max(waits + gets) <= 0.4
    assert late("1") == (is_same, [waits, gets, begins])
    assert late("2") != (is_same, [waits, gets, begins])


def test_nothing_of_the_shell_is_inherited(run: Run, tmp_path: Path) -> None:
    found = run(
        """
        import os, tempfile, threading
        from pathlib import Path

        def test_what_is_for_the_tests_themselves_is_reported():
            assert threading.Thread.run.__module__ == "tests.harness._delays"

        def test_places():
            assert not {"DISPLAY", "ROS_DOMAIN_ID", "UOARM_HOME", "LC_ALL"} & os.environ.keys()
            assert not [name for name in os.environ if name.startswith("PYTHON")]
            assert Path.home().name == "home"
            assert Path.home().parent == Path(tempfile.gettempdir()).parent
        """,
        DISPLAY=":9",
        ROS_DOMAIN_ID="7",
        UOARM_HOME=str(tmp_path),
        PYTHONSTARTUP="nothing.py",
        LC_ALL="C",
        UOARM_TEST_DELAYS="1",
    )
    found.assert_outcomes(passed=2)


IGNORING = """
import signal, sys
for name in sys.argv[1].split(","):
    signal.signal(getattr(signal, name), signal.SIG_IGN)
import pytest
sys.exit(pytest.main(sys.argv[2:]))
"""


VARIABLE = re.compile(r'environ(?:\.get\(|\[)"((?:UOARM|VDA5050)_[A-Z0-9_]+)"')


def test_what_tests_are_given_by_the_environment_reaches_them() -> None:
    files = [*ROOT.glob("tests/**/*.py"), *ROOT.glob("plugins/*/tests/**/*.py")]
    read = {name for file in files for name in VARIABLE.findall(file.read_text("utf-8"))}
    assert "UOARM_ROSBRIDGE_SUITE" in read
    assert not [name for name in sorted(read) if not _places.is_kept(name)]


TESTS["limits"] = """
    import sys
    import pytest
    from uoarm.testing import patience

    @pytest.mark.long  # the imports take more than the modules beside this one may
    def test_late():
        assert "uoarm._host.remote_bridge" not in sys.modules
        assert "uoarm.server" not in sys.modules
        from uoarm._host.remote_bridge import _PROMPT_SECONDS
        from uoarm.server import Limits
        assert _PROMPT_SECONDS == Limits().queue_seconds == patience()
"""


def test_limits_of_what_is_imported_by_a_test_are_lengthened_too(ran: Ran) -> None:
    assert ran.outcomes("limits") == {"passed": 1}


def test_limits_that_are_lengthened_exist() -> None:
    """Of the packages that are installed here: their modules are imported in a process apart."""
    script = """
import importlib, importlib.util
from tests.harness._limits import LIMITED, LongLimits

LongLimits(60.0).install()
for name in sorted(LIMITED):
    if importlib.util.find_spec(name.partition(".")[0]) is not None:
        importlib.import_module(name)
        print(name)
"""
    done = run_python("-c", script, cwd=ROOT)
    assert not done.returncode, done.stderr
    assert "uoarm._host.remote_bridge" in done.stdout.split()


def test_ignored_signals_are_not_handed_down(pytester: pytest.Pytester, run: Run) -> None:
    """As under `nohup make test &`."""
    file = pytester.makepyfile(
        test_children="""
        import os, signal, subprocess, sys
        import pytest

        @pytest.mark.parametrize("name", ["SIGINT", "SIGHUP", "SIGTERM", "SIGQUIT"])
        def test_a_child_ends_by_a_signal(name):
            number = getattr(signal, name)
            with subprocess.Popen(["sleep", "1000"]) as process:
                process.send_signal(number)
                assert process.wait() == -number
            os.kill(os.getpid(), number) if name != "SIGTERM" else None
        """
    )
    command = [sys.executable, "-c", IGNORING, "SIGINT,SIGHUP,SIGQUIT", "-p", "tests.harness"]
    done = subprocess.run(
        [*command, str(file)],
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
        timeout=2 * patience(),
    )
    assert "4 passed" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("automatic", [False, True], ids=["by hand", "in automation"])
def test_what_is_missing_is_a_skip_by_hand_and_a_failure_in_automation(
    run: Run, automatic: bool
) -> None:
    found = run(
        """
        import pytest

        @pytest.mark.needs("dream")
        def test_package():
            raise AssertionError

        @pytest.mark.needs("engine")
        def test_program():
            raise AssertionError

        @pytest.mark.needs("here")
        def test_what_is_here():
            pass

        @pytest.mark.needs("preloaded")
        def test_library():
            raise AssertionError

        @pytest.mark.needs("elsewhere")
        def test_another_machine():
            raise AssertionError
        """,
        "-ra",
        set_up="""
from tests.harness._needs import NEEDS, Need
NEEDS["dream"] = Need("pip install dream", packages=("no_such_package",))
NEEDS["engine"] = Need("apt install engine", programs=("no-such-program",))
NEEDS["preloaded"] = Need("apt install library", files=("nowhere/*/a.so", "nowhere/a.so"))
NEEDS["here"] = Need("apt install base-files", files=("nowhere/*", "*"))
far = frozenset({("Multics", "GE-645")})
NEEDS["elsewhere"] = Need("pip install it", packages=("no_such_package",), systems=far)
""",
        **({"CI": "true"} if automatic else {}),
    )
    found.assert_outcomes(skipped=3 if automatic else 4, passed=1, errors=1 if automatic else 0)
    found.stdout.fnmatch_lines(["*needs no_such_package: pip install dream*"])
    found.stdout.fnmatch_lines(["*needs no-such-program: apt install engine*"])
    found.stdout.fnmatch_lines(["*needs a.so: apt install library*"])
    found.stdout.fnmatch_lines(["*no_such_package: not there for *"])


@pytest.mark.parametrize("page", [".ci/run", "CONTRIBUTING.md"])
def test_what_is_to_be_had_from_debian_is_installed_and_named(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    wanted = {
        package
        for need in NEEDS.values()
        if "apt install " in need.get
        for package in need.get.partition("apt install ")[2].partition(",")[0].split()
    }
    assert "libfaketime" in wanted
    named = {name for name in wanted if re.search(rf"[`( ]{re.escape(name)}[`) ]", text)}
    assert named == wanted


def test_there_are_more_workers_than_cores_unless_their_number_is_given(
    pytestconfig: pytest.Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask = pytestconfig.hook.pytest_xdist_auto_num_workers
    monkeypatch.setenv("PYTEST_XDIST_AUTO_NUM_WORKERS", "3")
    assert ask(config=pytestconfig) == 3
    monkeypatch.delenv("PYTEST_XDIST_AUTO_NUM_WORKERS")
    cores = xdist.plugin.pytest_xdist_auto_num_workers(pytestconfig)
    assert ask(config=pytestconfig) == cores + min(cores, SPARE_WORKERS)


def test_the_scheduler_keeps_no_test_that_is_complete(pytestconfig: pytest.Config) -> None:
    config, worker = Mock(wraps=pytestconfig), Mock(shutting_down=False)
    config.getvalue = {"tx": ["popen"]}.get
    config.option.loadscopereorder = False
    scheduler = Scheduler(config, Producer("test", enabled=False))
    tests = [f"test_one.py::test_{number}" for number in range(20)]
    scheduler.add_node(worker)
    scheduler.add_node_collection(worker, tests)
    scheduler.schedule()
    for index, test in enumerate(tests):
        scheduler.mark_test_complete(worker, index)
        assert test not in scheduler.assigned_work[worker]
        assert len(scheduler.assigned_work[worker]) <= 3
    assert not scheduler.has_pending
    assert [call.args[0] for call in worker.send_runtest_some.call_args_list] == [
        [index] for index in range(20)
    ]


def test_the_tests_of_a_plugin_have_the_settings_of_all() -> None:
    """pytest takes those of the first pyproject.toml, upwards, that has any: there is one alone."""
    settings = list(ROOT.glob("plugins/*/pyproject.toml"))
    assert len(settings) == len(list(ROOT.glob("plugins/*/src")))
    assert not [path for path in settings if "[tool.pytest" in path.read_text(encoding="utf-8")]


def test_whatever_a_tier_or_a_module_needs_is_known() -> None:
    needed = [*(tier.needs for tier in TIERS), *MODULES.values()]
    assert {name for names in needed for name in names} <= NEEDS.keys()


def test_a_test_that_needs_something_where_no_tier_looks_for_it_is_an_error(
    run: Run, pytester: pytest.Pytester
) -> None:
    test = "import pytest\n\n@pytest.mark.needs('compiler')\ndef test_compiled(): pass\n"
    for folder in ("server", "wire"):  # it fails with the first that is in no place
        place = pytester.path / "tests" / folder
        place.mkdir(parents=True)
        (place / f"test_{folder}.py").write_text(test, encoding="utf-8")
    done = run("", "tests", "-m", "not needs")
    assert done.ret == pytest.ExitCode.USAGE_ERROR
    assert "tests/wire/test_wire.py needs something" in done.stderr.str()
    assert "test_server.py" not in done.stderr.str()


def test_a_module_whose_tests_are_left_out_is_not_imported(
    run: Run, pytester: pytest.Pytester
) -> None:
    assert "tests/record/*" in MODULES
    place = pytester.path / "tests" / "record"
    place.mkdir(parents=True)
    (place / "test_heavy.py").write_text("raise AssertionError", encoding="utf-8")
    done = run("", "tests", "-m", "not needs")
    assert done.ret == pytest.ExitCode.NO_TESTS_COLLECTED, done.stdout.str()


@pytest.mark.parametrize(
    "folder", sorted((ROOT / "plugins").glob("*/tests")), ids=lambda folder: folder.parent.name
)
def test_the_tests_of_each_plugin_are_run_by_default_at_length_and_late(folder: Path) -> None:
    place = folder.relative_to(ROOT).as_posix()
    ran = {tier.name: tier.arguments for tier in TIERS if place in tier.arguments}
    assert ["not long" in ran[name] for name in BY_DEFAULT if name in ran] == [True]
    at_length = {name: ran[name] for name in NAMES["long"] if name in ran}
    name = folder.parent.name.removeprefix("uoarm-")
    assert at_length == {
        f"long-{name}": (place,),
        f"late-{name}": (place, "-m", "not long"),
    }


MEETING = """
import sys
from pathlib import Path
from uoarm.testing import wait
own, peer, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
print(own, "begins", flush=True)
(folder / own).touch()
wait((folder / peer).exists)
print(own, "has met", peer)
"""
ALONE = """
import sys
from pathlib import Path
assert not list(Path(sys.argv[3]).iterdir())
"""


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Has each tier run the program that is its first argument; returns the folder they share."""

    def command(run: tiers.Run, is_beside: bool) -> list[str]:
        assert is_beside is not run.tier.is_alone
        return [sys.executable, "-c", *run.tier.arguments, str(tmp_path)]

    monkeypatch.setattr(tiers.Run, "_command", command)
    monkeypatch.setattr(tiers, "REPORTS", tmp_path.with_name("reports"))
    return tmp_path


def test_tiers_run_beside_each_other_and_each_is_shown_in_one_piece(
    programs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = (
        Tier("alone", "first", (ALONE, "", "")),
        Tier("one", "second", (MEETING, "one", "other"), is_alone=False),
        Tier("other", "third", (MEETING, "other", "one"), is_alone=False),
        Tier("last", "fourth", (ALONE, "", "")),
    )
    outcomes = run_all(given)
    assert [(outcome.tier.name, outcome.failed) for outcome in outcomes] == [
        ("alone", False), ("one", False), ("other", False), ("last", True),
    ]  # fmt: skip
    assert all(outcome.processor_seconds > 0 for outcome in outcomes)
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line][:7] == [
        "== alone: first",
        "== one: second", "one begins", "one has met other",
        "== other: third", "other begins", "other has met one",
    ]  # fmt: skip


def test_tiers_that_run_as_all_is_interrupted_are_ended(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", interrupted)
    given = [Tier(name, "", (MEETING, name, "?"), is_alone=False) for name in ("one", "other")]
    with pytest.raises(KeyboardInterrupt):
        run_all(given)


KIT = """
    import pytest
    from uoarm.model import Endpoint, Role
    from uoarm.testing import MemoryBridge
    from uoarm.testing.conformance import BridgeConformance, Pair, World

    class Memory(World):
        def bridge(self):
            made = MemoryBridge()
            made.loop("text", {"type": "string"})
            return made

        def pair(self, kind):
            ends = (Endpoint("memory", kind, role, (kind,)) for role in (Role.INPUT, Role.OUTPUT))
            return Pair(*ends)

        def missing(self):
            return Endpoint("memory", "nowhere", Role.OUTPUT, ("nowhere",))

    class TestMemory(BridgeConformance):
        kinds = ("text",)

        @pytest.fixture
        def world(self):
            return Memory()
"""
KIT_PAGE = """
# What the kit skips

| bridge | test or section | why |
|---|---|---|
| `memory` | kinds do not mix (text); a death is reported with its cause | it has one kind |
| `memory` | closing twice is closing once | it does not close |
| `other` | a retained message comes first | of another bridge |
"""


def test_a_skip_of_the_kit_and_its_row_in_the_table_need_one_another(
    run: Run, tmp_path: Path
) -> None:
    page = tmp_path / "skips.md"
    page.write_text(KIT_PAGE, encoding="utf-8")
    wanted = "kinds_do or test_a_death_is or test_closing_twice or retained"
    set_up = [
        "from pathlib import Path",
        "from tests.harness import _kit",
        "_kit._BRIDGES['test_'] = 'memory'",
        f"_kit._PAGE = Path({str(page)!r})",
    ]
    found = run(KIT, "-k", wanted, set_up="\n".join(set_up))
    found.assert_outcomes(skipped=2, failed=2)
    found.stdout.fnmatch_lines(
        [
            "*closing_twice*: no longer skipped: take it out of the row of 'memory' in *",
            "*retained*: skipped, as the world retains nothing: have the world give it, or add *",
        ]
    )


PATHS = """
    class TestPaths(TestMemory):
        kinds = ("text", "more", "other")
        paths = ("more", "other")

    class TestFewer(TestPaths):
        kinds = ("text",)
"""


def test_what_holds_of_a_link_is_tested_for_each_path_and_what_concerns_messages_with_each_kind(
    run: Run,
) -> None:
    wanted = "broken_can_be_closed or (TestPaths and pass_again)"
    printed = run(KIT + PATHS, "--collect-only", "-q", "-k", wanted).stdout.str()
    found = re.findall(r"::Test(\w+)::\w+_(closed|once)\[(\w+)\]", printed)
    assert found == [
        ("Memory", "closed", "text"),
        ("Paths", "once", "text"),
        ("Paths", "once", "more"),
        ("Paths", "once", "other"),
        ("Paths", "closed", "more"),
        ("Paths", "closed", "other"),
        ("Fewer", "closed", "text"),
    ]
