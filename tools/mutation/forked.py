"""Runs mutants of one module against the module's own tests, each in a process of its own that is forked.

Importing and collecting cost more than most tests, and most tests never come near the mistake. So a module's tests
are collected once, and two things are recorded: which functions of the module ran on the way there, and which each
test enters when it runs alone. A mutant that differs from the module in functions that have not run yet is made by
giving these functions their new code; only the tests that enter one of them can tell, and only they run, until one
fails: those that have killed most, then the fastest. Function objects stay the same, so it does not matter who imported
them by which name or put them into which table.

All other mutants, those in tables, classes, defaults and whatever runs at import, are imported anew with all the
module's tests; and so is every mutant that the short way found alive: no survivor rests on it.
"""

import ast
import gc
import importlib.abc
import importlib.util
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from importlib.machinery import ModuleSpec
from inspect import CO_OPTIMIZED
from itertools import zip_longest
from mmap import mmap
from pathlib import Path
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any, Final, TypeVar

import cantools  # noqa: F401 - loaded once, before the processes are forked
import cryptography.hazmat.primitives.cmac  # noqa: F401 - likewise
import hypothesis
import isotp  # noqa: F401 - likewise
import numpy  # noqa: F401, ICN001 - likewise
import pytest

from tools.mutation.mutants import Mutant

SLOWER: Final = 20
HANGS_S: Final = 2.0
"""A test that takes two seconds and twenty times its own time on the processor hangs. The wall clock says nothing."""
ASLEEP_S: Final = 20
"""So does one that waits so long for anything but the processor: no test here sleeps."""
SHORT_MIN: Final = 30
"""Below so many mutants it is not worth while to learn what the tests enter."""
FOLDER: Final = "PYTEST_DEBUG_TEMPROOT"
"""Where pytest makes its folders: one for each process, for they disturb each other."""
MEMORY_BYTES: Final = 8 << 30
OPTIONS: Final = (
    *("-x", "-q", "-s", "--assert=plain", "--tb=native", "-p", "no:cacheprovider"),
    *("-p", "pytest_timeout", "--timeout=0"),  # the only plugin the settings speak of
)


Result = TypeVar("Result")


class Verdict(Enum):
    """What became of a mutant."""

    FAILED = "a test failed"
    UNIMPORTABLE = "its import or the collection of its tests failed"
    HANGS = "a test did not end"
    ALIVE = "all tests passed"
    UNDECIDED = "its process ended otherwise"

    @property
    def killed(self) -> bool:
        """Whether the tests found the mistake."""
        return self in {Verdict.FAILED, Verdict.UNIMPORTABLE, Verdict.HANGS}


ENDS: Final[dict[int, Verdict]] = {
    int(pytest.ExitCode.OK): Verdict.ALIVE,
    int(pytest.ExitCode.TESTS_FAILED): Verdict.FAILED,
    int(pytest.ExitCode.INTERRUPTED): Verdict.UNIMPORTABLE,
    int(pytest.ExitCode.USAGE_ERROR): Verdict.UNIMPORTABLE,  # the conftest of its tests imports it
    -signal.SIGPROF: Verdict.HANGS,
}


class UnfitError(RuntimeError):
    """The tests fail without any mutant, so that their failing proves nothing; the message names them."""


# ---------------------------------------------------------------- processes


def pooled(tasks: Iterable[Callable[[], int]], jobs: int) -> Iterator[tuple[int, int]]:
    """Run each task in a fork of this process, ``jobs`` at a time; yields each one's number and exit code."""
    running: dict[int, tuple[int, str]] = {}
    for number, task in enumerate(tasks):
        if len(running) == jobs:
            yield _ended(running)
        child, folder = _forked(task)
        running[child] = number, folder
    while running:
        yield _ended(running)


def _ended(running: dict[int, tuple[int, str]]) -> tuple[int, int]:
    child, status = os.wait()
    number, folder = running.pop(child)
    shutil.rmtree(folder, ignore_errors=True)
    return number, os.waitstatus_to_exitcode(status)


def _forked(task: Callable[[], int]) -> tuple[int, str]:
    """Start a task; an error of its own ends it with a code that is nobody's verdict. Its folder is to be removed then."""
    folder = tempfile.mkdtemp(dir=os.environ.get(FOLDER))
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        code = os.EX_SOFTWARE
        try:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
            os.environ[FOLDER] = folder
            code = task()
        finally:
            os._exit(code)
    return child, folder


def _silently(task: Callable[[], Result]) -> Result:
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    return task()


def _limit(usual_s: float) -> None:
    """From now on, so much time on the processor and no more, and no long sleep."""
    signal.setitimer(signal.ITIMER_PROF, HANGS_S + SLOWER * usual_s)
    since_s = _asleep_s()

    def look(_number: int, _frame: FrameType | None) -> None:
        if _asleep_s() - since_s >= ASLEEP_S - 1:
            os.kill(os.getpid(), signal.SIGPROF)
        signal.alarm(ASLEEP_S)

    signal.signal(signal.SIGALRM, look)
    signal.alarm(ASLEEP_S)


def _asleep_s() -> float:
    """A clock that stands still while this process works or queues for a processor."""
    worked_ns, queued_ns, _ = Path("/proc/self/schedstat").read_text(encoding="ascii").split()
    return time.monotonic() - (int(worked_ns) + int(queued_ns)) / 1e9


def told(task: Callable[[], Result]) -> Result:
    """The task's result, from a fork of this process."""
    reading, writing = os.pipe()

    def tell() -> int:
        with os.fdopen(writing, "wb") as pipe:
            pickle.dump(task(), pipe)
        return os.EX_OK

    child, folder = _forked(tell)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    shutil.rmtree(folder, ignore_errors=True)
    if not said:
        raise UnfitError("a process that runs tests ended without a word")
    result: Result = pickle.loads(said)  # noqa: S301 - our own child's
    return result


# ---------------------------------------------------------------- code


class InPlace(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from code that is given."""

    def __init__(self, path: Path, root: Path, code: CodeType) -> None:
        self.name = ".".join(path.relative_to(root).with_suffix("").parts)
        self.code = code

    def find_spec(self, fullname: str, _path: Any, _target: ModuleType | None = None) -> ModuleSpec | None:
        """Answer for this module only."""
        return importlib.util.spec_from_loader(fullname, self) if fullname == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        """Run the given code."""
        exec(self.code, module.__dict__)  # noqa: S102 - that is what this module is for


def functions(code: CodeType) -> Iterator[CodeType]:
    """The outermost functions of a module, methods among them, in the order of their making."""
    for inner in _inner(code):
        if inner.co_flags & CO_OPTIMIZED:
            yield inner
        else:  # the body of a class
            yield from functions(inner)


def everything(code: CodeType) -> Iterator[CodeType]:
    """The code itself and all that it makes."""
    yield code
    for inner in _inner(code):
        yield from everything(inner)


def _inner(code: CodeType) -> list[CodeType]:
    return [const for const in code.co_consts if isinstance(const, CodeType)]


def _same_but_for_functions(one: CodeType, other: CodeType) -> bool:
    """Whether two modules, or two classes, do the same until one of their functions is called."""
    mine, others = _inner(one), _inner(other)
    return (
        _bare(one) == _bare(other)
        and len(mine) == len(others)
        and all(
            a.co_freevars == b.co_freevars
            if a.co_flags & b.co_flags & CO_OPTIMIZED
            else _same_but_for_functions(a, b)
            for a, b in zip(mine, others, strict=True)
        )
    )


def _bare(code: CodeType) -> CodeType:
    consts = tuple(const.co_name if isinstance(const, CodeType) else const for const in code.co_consts)
    return code.replace(co_consts=consts)


def changes(one: CodeType, other: CodeType) -> dict[int, CodeType] | None:
    """By number of function, the new code of those that changed; None if what runs at import changed."""
    if not _same_but_for_functions(one, other):
        return None
    pairs = enumerate(zip(functions(one), functions(other), strict=True))
    return {number: new for number, (old, new) in pairs if old != new}


# ---------------------------------------------------------------- the long way


@dataclass(frozen=True)
class Usual:
    """What the module itself needs, in seconds on the processor.

    Attributes:
        collect_s: until the tests are collected.
        tests_s: for each test, by name.
    """

    collect_s: float
    tests_s: Mapping[str, float]


class Ranking:
    """In which order tests run, and how long each may take; shared by all processes that are forked later.

    First what exists only for a mutant, then the tests that have killed most, then the fastest.
    """

    def __init__(self, usual: Usual) -> None:
        self.usual = usual
        self.numbers = {name: number for number, name in enumerate(usual.tests_s)}
        self.kills = mmap(-1, len(self.numbers))

    def ordered(self, items: Iterable[pytest.Item]) -> list[pytest.Item]:
        """The tests in the order in which they run."""
        return sorted(items, key=lambda item: self._rank(item.nodeid))

    def _rank(self, name: str) -> tuple[int, float]:
        return (
            (-self.kills[self.numbers[name]], self.usual.tests_s[name])
            if name in self.numbers
            else (-256, 0.0)
        )

    def limit(self, item: pytest.Item) -> None:
        """Set the limit of this test; what exists only for a mutant has the longest."""
        _limit(self.usual.tests_s.get(item.nodeid, max(self.usual.tests_s.values())))

    def killed(self, name: str) -> None:
        """Note that this test has failed."""
        if name in self.numbers:
            self.kills[self.numbers[name]] = min(255, self.kills[self.numbers[name]] + 1)


class Measured:
    """A pytest plugin that finds out what is usual."""

    def __init__(self) -> None:
        self.collect_s = 0.0
        self.tests_s: dict[str, float] = {}

    def pytest_collection_finish(self) -> None:
        """All tests are collected."""
        self.collect_s = time.process_time()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Measure one test."""
        began_s = time.process_time()
        done = yield
        self.tests_s[item.nodeid] = time.process_time() - began_s
        return done


class Limited:
    """A pytest plugin: order and limits as the ranking says."""

    def __init__(self, ranking: Ranking) -> None:
        self.ranking = ranking

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Put the tests into order."""
        items[:] = self.ranking.ordered(items)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> None:
        """Begin one test."""
        self.ranking.limit(item)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Hear of a failure."""
        if report.failed:
            self.ranking.killed(report.nodeid)


# ---------------------------------------------------------------- the short way


class Collected:
    """A pytest plugin that, once the tests are collected, runs mutants instead of them."""

    def __init__(self, code: CodeType, mutants: Sequence[CodeType], ranking: Ranking, jobs: int) -> None:
        self.mutants, self.ranking, self.jobs = mutants, ranking, jobs
        self.code, self.functions = code, list(functions(code))
        self.verdicts: dict[int, Verdict] = {}
        self.unfit = ""
        """The first test that fails alone."""
        self.ran: set[int] = set()
        """The numbers of the functions that have run."""
        self.failed = False
        self.enters: dict[str, set[int]] = {}
        """The numbers of the functions that each test enters."""
        self.holders: dict[int, list[FunctionType]] = {}
        """The function objects of each function, by number."""
        self.numbers = {
            id(inner): number for number, outer in enumerate(self.functions) for inner in everything(outer)
        }

    def trace(self, frame: FrameType, _event: str, _arg: Any) -> None:
        """Notes the module's functions as they are entered."""
        number = self.numbers.get(id(frame.f_code))
        if number is not None:
            self.ran.add(number)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Hear of a failure in set-up, call or tear-down."""
        self.failed |= report.failed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Instead of the tests: learn what each enters, then run every mutant that needs no import."""
        _trace(None)
        at_import = self.ran
        self._find_holders()
        gc.freeze()  # collecting garbage would copy every page in every fork
        for item in session.items:
            passed, self.enters[item.nodeid] = told(partial(self._alone, item))
            if not passed:
                self.unfit = f"{item.nodeid} fails alone, without any mutant"
                return True
        swaps = {
            number: changed
            for number, mutant in enumerate(self.mutants)
            if (changed := changes(self.code, mutant))
            and not changed.keys() & at_import
            and changed.keys() <= self.holders.keys()
        }
        tasks = (partial(self._swapped, changed, session.items) for changed in swaps.values())
        which = list(swaps)
        for number, code in pooled(tasks, self.jobs):
            self.verdicts[which[number]] = ENDS.get(code, Verdict.UNDECIDED)
        return True

    def _find_holders(self) -> None:
        outer = {id(code): number for number, code in enumerate(self.functions)}
        for one in gc.get_objects():
            if isinstance(one, FunctionType) and id(one.__code__) in outer:
                self.holders.setdefault(outer[id(one.__code__)], []).append(one)

    def _alone(self, item: pytest.Item) -> tuple[bool, set[int]]:
        """Whether this one test passes, and what it enters."""
        self.ran = set()
        _trace(self.trace)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
        _trace(None)
        return not self.failed, self.ran

    def _swapped(self, changed: dict[int, CodeType], items: Sequence[pytest.Item]) -> int:
        """Give the functions their new code and run the tests that enter one; returns what pytest would."""
        for number, code in changed.items():
            for function in self.holders[number]:
                function.__code__ = code
        ordered = self.ranking.ordered(item for item in items if self.enters[item.nodeid] & changed.keys())
        for item, following in zip_longest(ordered, ordered[1:]):
            self.ranking.limit(item)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self.failed:
                self.ranking.killed(item.nodeid)
                return int(pytest.ExitCode.TESTS_FAILED)
        return int(pytest.ExitCode.OK)


def _trace(what: Callable[[FrameType, str, Any], None] | None) -> None:
    """In this thread and in all that begin from now on."""
    sys.settrace(what)
    threading.settrace(what)


# ---------------------------------------------------------------- both


@dataclass(frozen=True)
class Trial:
    """One module under its own tests."""

    module: Path
    root: Path
    tests: tuple[str, ...]
    jobs: int

    def verdicts(self, mutants: Sequence[Mutant]) -> list[Verdict]:
        """What becomes of each mutant.

        Raises:
            UnfitError: the tests fail without any mutant, together or alone.
        """
        with tempfile.TemporaryDirectory(prefix="cutgate-mutants-") as folder:
            os.environ[FOLDER] = folder
            return self._verdicts(mutants)

    def _verdicts(self, mutants: Sequence[Mutant]) -> list[Verdict]:
        original = self._code(ast.parse(self.module.read_text(encoding="utf-8")))
        codes = [self._code(mutant.tree) for mutant in mutants]
        usual = told(partial(_silently, partial(self._usual, original)))
        if usual is None:
            raise UnfitError(f"{self.module}: its own tests fail without any mutant")
        ranking = Ranking(usual)
        found: dict[int, Verdict] = {}
        if len(codes) >= SHORT_MIN:
            unfit, found = told(partial(_silently, partial(self._short, original, codes, ranking)))
            if unfit:
                raise UnfitError(f"{self.module}: {unfit}")
        left = [number for number in range(len(codes)) if found.get(number, Verdict.ALIVE) is Verdict.ALIVE]
        tasks = (partial(self._long, codes[number], ranking) for number in left)
        for number, code in pooled(tasks, self.jobs):
            found[left[number]] = ENDS.get(code, Verdict.UNDECIDED)
        return [found[number] for number in range(len(codes))]

    def _code(self, tree: ast.Module) -> CodeType:
        return compile(tree, str(self.module), "exec", dont_inherit=True)

    def _usual(self, code: CodeType) -> Usual | None:
        """What is usual without any mutant; None if the tests fail then."""
        plugin = Measured()
        passed = self._pytest(code, plugin) == pytest.ExitCode.OK
        return Usual(plugin.collect_s, plugin.tests_s) if passed else None

    def _short(
        self, original: CodeType, codes: Sequence[CodeType], ranking: Ranking
    ) -> tuple[str, dict[int, Verdict]]:
        """Why the tests are unfit, and the verdicts on all mutants that need no import."""
        plugin = Collected(original, codes, ranking, self.jobs)
        _trace(plugin.trace)
        self._pytest(original, plugin)
        return plugin.unfit, plugin.verdicts

    def _long(self, code: CodeType, ranking: Ranking) -> int:
        """All tests on one mutant, imported anew."""
        _limit(ranking.usual.collect_s)
        return _silently(partial(self._pytest, code, Limited(ranking)))

    def _pytest(self, code: CodeType, plugin: object) -> int:
        """Collect and run the module's tests in this process, with ``code`` in the module's place."""
        hypothesis.settings.register_profile(
            "mutation",
            database=None,
            deadline=None,
            derandomize=True,
            phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate],
            suppress_health_check=[hypothesis.HealthCheck.too_slow],
        )
        hypothesis.settings.load_profile("mutation")
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        sys.dont_write_bytecode = True
        sys.meta_path.insert(0, InPlace(self.module, self.root, code))
        os.chdir(self.root)
        return int(pytest.main([*OPTIONS, *self.tests], plugins=[plugin]))
