"""The C of a graph computes what JAX computes, for every operation that drivers use."""

import ctypes
import re
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.aboard import STRICT
from metropilot.aboard.emit import emit_body
from metropilot.aboard.graph import trace_graph
from metropilot.aboard.preamble import EXP_ULP, LOG_ULP, TANH_ULP, preamble
from metropilot.aboard.tables import Tables
from metropilot.errors import InputError
from metropilot.physics import double_precision

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
X = np.array([0.3, -1.7, 2.5, 0.0, -0.25, 4.0, 1e-9, -3.2])
TABLE = np.linspace(-1.0, 2.0, 40).reshape(2, 10, 2) ** 3
THIRDS = np.float32([1 / 3, 1 / 7, 1 / 9, 1 / 11]).astype(np.float64)
CODED = np.tile([1.5, -2.0, 0.3], 400)
RUNS = np.repeat(np.array([0.1, -2.0, 0.3, np.inf, -0.0, 0.0]), 200)
LINE = -3.0 + 0.5 * np.arange(1000)
SUM = 128.0 - np.cumsum(np.where(np.arange(900) < 500, 0.1, 1 / 7))
PACES = np.minimum(np.array([3.0, 5.0, 9.0]), 1.0 + 0.02 * np.arange(700)[:, None])
HALVES = np.append(np.random.default_rng(2).normal(0.0, 1.0, 399), -0.0).astype(np.float32)
HALVES = (HALVES.view(np.uint32) & 0xFFFF0000).view(np.float32).astype(np.float64)
SUMS = 1000.0 - np.cumsum(2.0 / PACES, axis=0)


def look_up(x, i):
    """Gather with a constant column, a slice at a moving place, an entry by number."""
    nodes = jnp.clip(i + jnp.arange(5), 0, 9)
    return (
        jnp.asarray(TABLE)[jnp.minimum(i, 1), nodes, 1]
        + jax.lax.dynamic_slice_in_dim(x, i, 5)
        + jnp.asarray(TABLE)[1, i, 0]
    )


FUNCTIONS = {
    "arithmetic": lambda x, i: (x[0] * x[1] - x[2]) / (1.0 + x[5]) + jnp.sqrt(jnp.abs(x)) * i,
    "functions": lambda x, i: jnp.exp(-x) + jnp.tanh(x * 3.0) + jnp.floor(x) + jnp.sign(x) + x**2 + x // 1.0,
    "choices": lambda x, i: jnp.where((x > 0.0) & (x < 3.0) | (x == -3.2), jnp.minimum(x, 2.0), -x),
    "reductions": lambda x, i: jnp.stack(
        [x.sum(), x.max(), x.min(), 1.0 * jnp.all(x < 5.0), 1.0 * jnp.any(x > 9)]
    ),
    "matrices": lambda x, i: (x @ jnp.asarray(TABLE.reshape(8, 5))) * jnp.asarray(TABLE.reshape(5, 8))[:, 2],
    "rows": lambda x, i: (x[None] * x[:, None])[1:4].sum(0) + jnp.concatenate([x[4:], x[:4]]) + x[::-1],
    "look up": look_up,
    "branches": lambda x, i: jax.lax.cond(x[i] > 0.0, lambda: x.sum() * 2.0, lambda: x[i] - 1.0),
    "largest": lambda x, i: jnp.argmax(x) + i,
    "whole numbers": lambda x, i: (x * 7.0).astype(jnp.int32) * i - 3,
    "not a number": lambda x, i: jnp.where(jnp.isfinite(x / 0.0), 1.0, jnp.maximum(x / x, 0.5)),
    "narrow table": lambda x, i: jnp.asarray(THIRDS)[i] * jnp.asarray(THIRDS)[i + 1] * x,
    "logarithm": lambda x, i: jnp.log(jnp.abs(x) + 1e-3),
    "rounds": lambda x, i: jnp.round(x * 4.0) + jnp.round(x * 2.0),
    "coded table": lambda x, i: jnp.asarray(CODED)[100 * i + 1] * x,
    "table of runs": lambda x, i: jnp.asarray(RUNS)[jnp.arange(1200) + 0 * i],
    "table on a line": lambda x, i: jnp.asarray(LINE)[jnp.arange(1000) + 0 * i],
    "table of steps": lambda x, i: jnp.asarray(SUM)[jnp.arange(900) + 0 * i],
    "table of halves": lambda x, i: (
        jnp.asarray(HALVES)[jnp.arange(400) + 0 * i] + jnp.asarray(HALVES, jnp.float32)[jnp.arange(400) + i]
    ),
    "row of steps": lambda x, i: jax.lax.dynamic_slice_in_dim(jnp.asarray(SUMS), 300 * i + 17, 1)[0],
    "entries of rows": lambda x, i: jnp.asarray(SUMS)[jnp.arange(700) + 0 * i, jnp.arange(700) % 3],
}


EXACT = (
    "coded table",
    "table of runs",
    "table on a line",
    "table of steps",
    "table of halves",
    "row of steps",
    "entries of rows",
)


def header(text, tables):
    """Text that comes before functions."""
    include = "#include <math.h>\n#include <stdbool.h>\n#include <stdint.h>\n#include <string.h>\n"
    return "\n".join([include + preamble("\n".join([text, *tables.lines])), *tables.lines, ""])


def compile_c(folder, text):
    (folder / "one.c").write_text(text)
    command = ["cc", *STRICT, "-O1", "-shared", "-fPIC", "one.c", "-lm", "-o", "one.so"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "one.so"))


@pytest.fixture(scope="module")
def shared_library(tmp_path_factory):
    """All functions in one source, compiled once."""
    tables, bodies, results = Tables(), [], {}
    with double_precision(), jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        for number, (name, function) in enumerate(FUNCTIONS.items()):
            graph = trace_graph(function, jnp.asarray(X), jnp.int32(0))
            lines = emit_body(graph, ["x", "i"], ["out" if graph.outputs[0].shape else "*out"], tables)
            kind = {"f": "double", "i": f"int{8 * graph.outputs[0].dtype.itemsize}_t"}[
                graph.outputs[0].dtype.kind
            ]
            head = f"void f{number}(const double *x, int32_t i, {kind} *out);\n"
            head += f"void f{number}(const double *x, int32_t i, {kind} *out)\n{{\n    (void)x; (void)i;"
            bodies.append("\n".join([head, *lines, "}"]))
            results[name] = graph.outputs[0]
    text = "\n".join(bodies)
    library = compile_c(tmp_path_factory.mktemp("emit"), header(text, tables) + text)
    return library, results, tables


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("i", [0, 2])
def test_c_computes_what_jax_computes(shared_library, name, i):
    library, results, _ = shared_library
    out = np.zeros(results[name].shape, results[name].dtype)
    function = getattr(library, f"f{list(FUNCTIONS).index(name)}")
    function(X.ctypes.data_as(ctypes.c_void_p), ctypes.c_int32(i), out.ctypes.data_as(ctypes.c_void_p))
    with double_precision(), jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        expected = np.asarray(FUNCTIONS[name](jnp.asarray(X), jnp.int32(i)))
    np.testing.assert_allclose(out, expected, rtol=1e-14, atol=1e-15)
    if name in EXACT:
        assert out.tobytes() == expected.tobytes()


@pytest.mark.parametrize(
    ("values", "begin", "share"),
    [
        (CODED, "static const uint8_t t0_of[1200]", 0.2),
        (RUNS, "static const uint32_t t0_begins[38]", 0.05),
        (LINE, None, 0.0),
        (SUM, "static const step_table t0 ", 0.3),
        (SUMS, "static const step_table t0 ", 0.5),
        (HALVES, "static const uint16_t t0[400]", 0.25),
        (HALVES.astype(np.float32), "static const uint16_t t0[400]", 0.5),
        (np.append(HALVES[:-1], 1.0 + 2.0**-8).astype(np.float32), "static const float t0[400]", 1.0),
        (np.random.default_rng(1).random(300), "static const double t0[300]", 1.0),
    ],
)
def test_a_table_has_the_shortest_form(values, begin, share):
    tables = Tables()
    tables.at(values, "i")
    assert tables.bytes <= share * values.nbytes
    assert (not tables.lines) if begin is None else any(line.startswith(begin) for line in tables.lines)


def test_equal_arrays_of_two_tables_are_stored_once():
    tables = Tables()
    tables.at(RUNS, "i")
    before = tables.bytes
    longer = np.append(RUNS, np.full(300, RUNS[-1]))
    assert tables.at(longer, "i").startswith("t0[run_of(t1_begins, ")
    assert tables.bytes - before < 300


LONG = np.cos(np.arange(64.0))
MEMORIES = {
    "in place": (lambda m, x: (m * x[0] + x[1], x[2]), 0),
    "turned": (lambda m, x: (m[::-1] + x[0], m[3]), 64),
    "read later": (lambda m, x: (m + x[0], (m * x[1]).sum() + jnp.exp(m[::-1].max())), 64),
    "kept": (lambda m, x: (jnp.where(x[2] > 0.0, m - jnp.exp(m) * x[1], m), x[0]), 0),
    "sum of the next": (lambda m, x: (next_ := jnp.exp(m) * x[0], (next_[1:] - next_[:-1]).max()), 0),
    "read by both": (lambda m, x: ((last := jnp.tanh(m)) + last[::-1], last.sum() + m[0]), 64),
}


@pytest.mark.parametrize("name", MEMORIES)
def test_a_memory_is_written_where_it_belongs_once_nothing_reads_it(tmp_path, name):
    function, most = MEMORIES[name]
    tables, memory, out = Tables(), LONG.copy(), np.zeros(1)
    with double_precision(), jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        graph = trace_graph(function, jnp.asarray(LONG), jnp.asarray(X))
        expected = [np.asarray(each) for each in function(jnp.asarray(LONG), jnp.asarray(X))]
        body = "\n".join(emit_body(graph, ["m", "x"], ["m", "*out"], tables))
    text = "void f(double *m, const double *x, double *out);\n"
    text += f"void f(double *m, const double *x, double *out)\n{{\n    (void)x;\n{body}\n}}\n"
    library = compile_c(tmp_path, header(text, tables) + text)
    library.f(*(each.ctypes.data_as(ctypes.c_void_p) for each in (memory, X, out)))
    np.testing.assert_allclose(memory, expected[0], rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(out[0], expected[1], rtol=1e-13)
    assert sum(map(int, re.findall(r"double w_f64\[(\d+)\]", body))) == most


def test_what_has_no_form_in_c_is_refused_by_name():
    graph = trace_graph(jnp.cumsum, jnp.zeros(4))
    with pytest.raises(InputError, match="cumsum, which has no form in C"):
        emit_body(graph, ["x"], ["out"], Tables())


@pytest.mark.parametrize(
    ("name", "low", "high", "most"),
    [("exp", -700.0, 709.0, EXP_ULP), ("tanh", -25.0, 25.0, TANH_ULP), ("log", 1e-9, 1e3, LOG_ULP)],
)
def test_functions_are_as_exact_as_they_say(tmp_path, name, low, high, most):
    wrapper = f"double call(double x);\ndouble call(double x) {{ return {name}_f64(x); }}\n"
    library = compile_c(tmp_path, header(wrapper, Tables()) + wrapper)
    library.call.restype, library.call.argtypes = ctypes.c_double, [ctypes.c_double]
    rng = np.random.default_rng(3)
    x = np.concatenate([rng.uniform(low, high, 4000), rng.normal(0.0, 0.5, 4000), [0.0, 0.625, -0.625]])
    if name == "log":
        x = np.concatenate(
            [np.abs(x[x != 0.0]), 10.0 ** rng.uniform(-320.0, 308.0, 4000), [2.0**0.5, 5e-324]]
        )
    found = np.array([library.call(each) for each in x])
    exact = getattr(np, name)(x.astype(np.longdouble))
    ulp = np.abs(found - exact) / np.spacing(np.abs(exact.astype(np.float64)))
    assert ulp.max() <= most
    assert library.call(np.inf) == (1.0 if name == "tanh" else np.inf)
    if name == "log":
        assert library.call(0.0) == -np.inf
        assert np.isnan(library.call(-np.inf))
    else:
        assert library.call(-np.inf) == (0.0 if name == "exp" else -1.0)
    assert np.isnan(library.call(np.nan))
