"""Functions that a generated source may call: each is written only if it is used."""

from __future__ import annotations

import re
from types import MappingProxyType

from metropilot.aboard.tables import MOST_COLUMNS

SINGLE = """
/* the larger number; NaN wins, as in NumPy */
static TYPE max_SHORT(TYPE a, TYPE b) { return (a >= b || a != a) ? a : b; }

/* the smaller number; NaN wins */
static TYPE min_SHORT(TYPE a, TYPE b) { return (a <= b || a != a) ? a : b; }

/* a number, but no less than a constant; NaN stays */
static TYPE at_least_SHORT(TYPE x, TYPE least) { return x < least ? least : x; }

/* a number, but no more than a constant; NaN stays */
static TYPE at_most_SHORT(TYPE x, TYPE most) { return x > most ? most : x; }

static TYPE abs_SHORT(TYPE x) { return x < 0 ? -x : x; }

static bool finite_SHORT(TYPE x) { return x - x == 0; }

static TYPE sign_SHORT(TYPE x) { return x > 0 ? (TYPE)1 : x < 0 ? (TYPE)-1 : x; }

/* the whole part; beyond 2^52 every number is whole */
static TYPE whole_SHORT(TYPE x)
{
    if (!(x > (TYPE)-4503599627370496.0 && x < (TYPE)4503599627370496.0)) return x;
    return (TYPE)(int64_t)x;
}

static TYPE floor_SHORT(TYPE x)
{
    const TYPE t = whole_SHORT(x);
    return t > x ? t - 1 : t;
}

static TYPE fraction_SHORT(TYPE x) { return x - whole_SHORT(x); }

/* the nearest whole number, halves away from zero */
static TYPE round_SHORT(TYPE x)
{
    const TYPE t = whole_SHORT(x), rest = x - t;
    return rest >= (TYPE)0.5 ? t + 1 : rest <= (TYPE)-0.5 ? t - 1 : t;
}

/* the nearest whole number, halves to the even one */
static TYPE even_SHORT(TYPE x)
{
    const TYPE t = floor_SHORT(x), rest = x - t, half = (TYPE)0.5 * t;
    if (rest == (TYPE)0.5) return half == whole_SHORT(half) ? t : t + 1;
    return rest > (TYPE)0.5 ? t + 1 : t;
}
"""
BASE = """
/* an index, kept inside an array */
static int32_t within(int64_t i, int32_t last) { return i < 0 ? 0 : i > last ? last : (int32_t)i; }

/* which run an entry of a table is in: begins has a bit for each entry, runs the runs before each word */
static int32_t run_of(const uint32_t *begins, const int16_t *runs, int32_t i)
{
    uint32_t x = begins[i / 32] & (0xffffffffu >> (31 - i % 32));
    x -= (x >> 1) & 0x55555555u;
    x = (x & 0x33333333u) + ((x >> 2) & 0x33333333u);
    x = (((x + (x >> 4)) & 0x0f0f0f0fu) * 0x01010101u) >> 24;
    return runs[i / 32] + (int32_t)x;
}

/* a number in single precision by the upper half of its bits; the lower one is zero */
static float single_of(uint16_t upper)
{
    const uint32_t bits = (uint32_t)upper << 16;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* a table in fixed point: in blocks of 2^bits rows, each entry by the change of its step from the row before;
 * columns of one table are read by rows, of a single column by entries */
typedef struct {
    uint32_t columns, bits;
    const int64_t *base, *step;
    const uint16_t *first;
    const int64_t *literal;
    const uint8_t *codes;
    const int8_t *beside, *change;
} step_table;
static void step_row(const step_table *t, int32_t row, int64_t *value)
{
    int64_t step[MOST_COLUMNS] = {0};
    const uint32_t columns = t->columns, last = (uint32_t)row, block = last >> t->bits;
    const uint32_t begin = block << t->bits;
    const int64_t *literal = t->literal + t->first[block];
    uint32_t code = (begin + 1) * columns;
    for (uint32_t c = 0; c < columns; c++) {
        value[c] = t->base[block * columns + c];
        step[c] = t->step[block * columns + c];
    }
    for (uint32_t k = begin; k < last; k++) {
        int64_t beside = 0;
        for (uint32_t c = 0; c < columns; c++, code++) {
            const uint32_t symbol = ((uint32_t)t->codes[code / 2] >> (code % 2 * 4)) & 15u;
            if (symbol == 15) beside = *literal++;
            else beside = (t->beside[symbol] ? beside : step[c]) + t->change[symbol];
            step[c] = beside;
            value[c] += beside;
        }
    }
}

static int64_t step_entry(const step_table *t, int32_t i)
{
    int64_t values[MOST_COLUMNS] = {0};
    const uint32_t last = (uint32_t)i, block = last >> t->bits;
    if (t->columns == 1) {
        int64_t value = t->base[block], step = t->step[block];
        const int64_t *literal = t->literal + t->first[block];
        for (uint32_t k = (block << t->bits) + 1; k <= last; k++) {
            const uint32_t symbol = ((uint32_t)t->codes[k / 2] >> (k % 2 * 4)) & 15u;
            step = symbol == 15 ? *literal++ : step + t->change[symbol];
            value += step;
        }
        return value;
    }
    step_row(t, (int32_t)(last / t->columns), values);
    return values[last % t->columns];
}

/* a whole number; one out of range becomes the nearest, NaN becomes 0 */
static int32_t to_i32(double x)
{
    if (x != x) return 0;
    if (x <= -2147483648.0) return INT32_MIN;
    if (x >= 2147483647.0) return INT32_MAX;
    return (int32_t)x;
}

/* e^x, within EXP_ULP units in the last place: 2^n times a rational function (Cephes, Moshier 1984) */
static double exp_f64(double x)
{
    uint64_t bits;
    double n, xx, p, scale;
    if (x != x) return x;
    if (x > 709.782712893383973096) return (double)INFINITY;
    if (x < -708.0) return 0.0;
    n = floor_f64(1.4426950408889634073599 * x + 0.5);
    x -= n * 6.93145751953125e-1;
    x -= n * 1.42860682030941723212e-6;
    xx = x * x;
    p = x * ((1.26177193074810590878e-4 * xx + 3.02994407707441961300e-2) * xx + 9.99999999999999999910e-1);
    x = p / ((((3.00198505138664455042e-6 * xx + 2.52448340349684104192e-3) * xx
               + 2.27265548208155028766e-1) * xx + 2.0) - p);
    /* 2^1024 has no exponent of its own: half of it, twice */
    bits = (uint64_t)((int64_t)n - (n > 1023.0 ? 1 : 0) + 1023) << 52;
    memcpy(&scale, &bits, sizeof scale);
    return (1.0 + 2.0 * x) * scale * (n > 1023.0 ? 2.0 : 1.0);
}

static float exp_f32(float x) { return (float)exp_f64((double)x); }

/* tanh x, within TANH_ULP units in the last place (Cephes) */
static double tanh_f64(double x)
{
    const double z = abs_f64(x);
    if (x != x) return x;
    if (z > 22.0) return x > 0.0 ? 1.0 : -1.0;
    if (z >= 0.625) {
        const double t = 1.0 - 2.0 / (exp_f64(2.0 * z) + 1.0);
        return x > 0.0 ? t : -t;
    }
    {
        const double s = x * x;
        const double p = (-9.64399179425052238628e-1 * s - 9.92877231001918586564e1) * s
                         - 1.61468768441708447952e3;
        const double q = ((s + 1.12811678491632931402e2) * s + 2.23548839060100448583e3) * s
                         + 4.84406305325125486048e3;
        return x + x * s * (p / q);
    }
}

static float tanh_f32(float x) { return (float)tanh_f64((double)x); }

/* natural logarithm, within LOG_ULP units in the last place (fdlibm, Sun Microsystems 1993) */
static double log_f64(double x)
{
    uint64_t bits;
    double n = 0.0, f, s, z, w, r, half;
    if (x != x || x == (double)INFINITY) return x;
    if (x <= 0.0) return x < 0.0 ? (double)NAN : -(double)INFINITY;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0;
        n = -54.0;
    }
    memcpy(&bits, &x, sizeof bits);
    n += (double)((int64_t)(bits >> 52) - 1023);
    bits = (bits & 0xfffffffffffffu) | 0x3ff0000000000000u;
    memcpy(&x, &bits, sizeof x);
    if (x > 1.41421356237309504880) {
        x *= 0.5;
        n += 1.0;
    }
    f = x - 1.0;
    s = f / (2.0 + f);
    z = s * s;
    w = z * z;
    r = w * (3.999999999940941908e-1 + w * (2.222219843214978396e-1 + w * 1.531383769920937332e-1))
        + z * (6.666666666666735130e-1 + w * (2.857142874366239149e-1
        + w * (1.818357216161805012e-1 + w * 1.479819860511658591e-1)));
    half = 0.5 * f * f;
    return n * 6.93147180369123816490e-1 - ((half - (s * (half + r) + n * 1.90821492927058770002e-10)) - f);
}

static float log_f32(float x) { return (float)log_f64((double)x); }
"""
EXP_ULP, TANH_ULP, LOG_ULP = 2, 2, 1
"""Largest errors of ``exp``, ``tanh`` and ``log``, units in the last place; a test measures them."""
FUNCTION = re.compile(r"^static \w+ (\w+)\(", re.MULTILINE)


def _functions() -> dict[str, str]:
    """Text of every function by its name, in an order in which each comes after those that it calls."""
    doubles = SINGLE.replace("TYPE", "double").replace("SHORT", "f64")
    floats = SINGLE.replace("TYPE", "float").replace("SHORT", "f32")
    base = (
        BASE.replace("EXP_ULP", str(EXP_ULP))
        .replace("TANH_ULP", str(TANH_ULP))
        .replace("LOG_ULP", str(LOG_ULP))
        .replace("MOST_COLUMNS", str(MOST_COLUMNS))
    )
    found = {}
    for part in (doubles + floats + base).strip().split("\n\n"):
        match = FUNCTION.search(part)
        if match is None:
            raise ValueError(f"not a function: {part}")
        found[match[1]] = part.strip()
    return found


FUNCTIONS = MappingProxyType(_functions())


def preamble(body: str) -> str:
    """The functions that a text calls, and those that they call.

    Args:
        body: Text of the generated functions.
    """
    wanted: list[str] = []
    text = body
    for name in reversed(FUNCTIONS):
        if re.search(rf"\b{name}\(", text):
            wanted.append(FUNCTIONS[name])
            text += FUNCTIONS[name]
    return "\n\n".join(reversed(wanted))
