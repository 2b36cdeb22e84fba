"""Conditions of every test: checked shapes and types, strict numerics, reproducible searches.

Nothing here imports JAX, so that a test of lines and trainsets does not pay for it.
"""

import atexit
import os
import shutil
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import pytest
from hypothesis import settings
from tests import checking

# JAX reads these when it is first imported: no silent promotion of dtypes or ranks, CPU only.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["JAX_NUMPY_DTYPE_PROMOTION"] = "strict"
os.environ["JAX_NUMPY_RANK_PROMOTION"] = "raise"
os.environ["MPLBACKEND"] = "Agg"
# Learning runs and optima of all test processes go into one folder of their own, never the user's.
if "METROPILOT_TEST_HOME" not in os.environ:
    os.environ["METROPILOT_TEST_HOME"] = tempfile.mkdtemp(prefix="metropilot-tests-")
    atexit.register(shutil.rmtree, os.environ["METROPILOT_TEST_HOME"], ignore_errors=True)
    # What runs once is not worth optimising hard: LLVM at level 1 and, where XLA still has them, its older
    # emitters take half the time. XLA ends a program that gives it a flag it does not know.
    _quick = ["--xla_backend_optimization_level=1", "--xla_llvm_disable_expensive_passes=true"]
    if version("jaxlib").startswith("0.10."):
        _quick.append("--xla_cpu_use_fusion_emitters=false")
    os.environ["XLA_FLAGS"] = " ".join([*_quick, os.environ.get("XLA_FLAGS", "")]).strip()
os.environ["METROPILOT_HOME"] = os.environ["METROPILOT_TEST_HOME"]

# Here a program runs for a moment: LLVM is not asked to optimise it at all.
BRIEF = ("browser", "drivers", "learn", "physics", "studies", "env")

# Every annotated function of metropilot checks its arguments' types and array shapes.
checking.install("metropilot")

# Most of the suite's time would be compiling: what one process has compiled all others take, programs that
# tests start included, and so does the next suite. JAX looks a program up by its instructions, the folder is
# named by JAX, compiler flags and processor, so that no result can change.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    from metropilot.learn import compiler_id, trim_cache

    compiled = Path(__file__).parents[1] / ".pytest_cache" / "compiled" / compiler_id()
    compiled.mkdir(parents=True, exist_ok=True)
    trim_cache(compiled)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(compiled)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

settings.register_profile("dev", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, print_blob=True, derandomize=True, database=None)
settings.load_profile("ci" if os.environ.get("CI") else "dev")


# Cases and files that `make test` leaves to `make test-all`, each by the beginning of its name; see the file.
SLOW = tuple(
    line
    for line in (Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
)
ALL = 3000
"""With more tests than these, all are collected."""


@pytest.hookimpl(tryfirst=True)  # before -m looks at the marks
def pytest_collection_modifyitems(items):
    names = [item.nodeid for item in items]
    for item, name in zip(items, names, strict=True):
        if name.startswith(SLOW):
            item.add_marker(pytest.mark.slow)
    browsed = any(name.startswith("tests/browser") for name in names)
    wanted = [name for name in SLOW if browsed or not name.startswith("tests/browser")]
    if len(items) > ALL and (gone := [name for name in wanted if not any(n.startswith(name) for n in names)]):
        raise pytest.UsageError(f"tests/slow.txt names tests that are not there: {', '.join(gone)}")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    checking.begin_test()
    brief = item.path.relative_to(Path(__file__).parent).parts[0] in BRIEF
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(brief))
    if (jax := sys.modules.get("jax")) is not None:
        jax.config.update("jax_disable_most_optimizations", brief)
