"""Damage to a real file that a loader's own checks must meet: in its tree, in its text, in its bytes.

All randomness comes from a ``random.Random``, so that Hypothesis, the coverage-guided fuzzer and a replay by
seed make the same damage.
"""

import json
import tomllib
from collections.abc import Callable
from random import Random

import tomli_w

HUGE, DEEP, LONG = "@huge@", "@deep@", "@long@"
"""Stand for what the writers refuse to write; put in as raw text afterwards."""
RAW = {HUGE: "9" * 5000, DEEP: "[" * 3000 + "]" * 3000, LONG: "[" + "0," * 3000 + "0]"}
POISON = (
    *(None, True, False, 0, 1, -1, 2, 7, 0.5, -0.0, 5e-324, 1e-9, 1e6, 1e9, 1e15, 1e30, 1e308, -1e308),
    *(float("nan"), float("inf"), float("-inf"), 10**19, -(2**63), 10**400),
    *(
        "",
        " ",
        "x",
        "\x00",
        "\x1b[31m",
        "\n",
        "é€𝛼",
        "\ud800",
        "²",
        "../..",
        "/dev/zero",
        "nan",
        "1e999",
        "a" * 5000,
    ),
    *([], {}, [[]], [None], {"": ""}, {"a": {"b": {}}}, [1, "x", None], HUGE, DEEP, LONG),
)
BYTES = (
    b"\x00",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\xfe\xff",
    b"[",
    b"]",
    b"{",
    b"}",
    b'"',
    b"=",
    b"\n",
    b"\r",
    b",",
    b"-",
)


def damaged(data: bytes, kind: str, random: Random) -> bytes:
    """A real file, damaged once or a few times.

    Args:
        data: The file.
        kind: Its format: ``toml``, ``json``, ``safetensors``, ``csv`` or ``text``.
        random: Where every choice comes from.
    """
    if random.random() < 0.75:
        try:
            return KINDS[kind](data, random)
        except (ValueError, TypeError, LookupError, ArithmeticError, RecursionError, AttributeError):
            pass
    return in_bytes(data, random)


def in_tree(tree: object, random: Random) -> object:
    """A tree of plain values with one to four changes."""
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        places = list(_places(tree))
        if not places:
            return random.choice(POISON)
        holder, key = random.choice(places)
        change = random.randrange(7)
        if change == 0:
            del holder[key]
        elif change == 1:
            other, there = random.choice(places)
            holder[key] = other[there] if there in other or isinstance(other, list) else None
        elif change == 2 and isinstance(holder, dict):
            holder[random.choice((f"{key}x", str(key)[:-1], "", "units", "a.b", "é"))] = holder[key]
        elif change == 3 and isinstance(holder[key], int | float):
            holder[key] = holder[key] * random.choice((-1, 0, 1e-9, 10, 1e6, 1e300))
        elif change == 4 and isinstance(holder[key], list):
            holder[key] = holder[key] * random.choice((0, 2, 50)) or [holder[key]]
        else:
            holder[key] = random.choice(POISON)
    return tree


def _places(tree: object) -> list:
    """Every holder and key of a tree, of long lists the ends."""
    found, todo, seen = [], [tree], 0
    while todo and seen < 400:
        node, seen = todo.pop(), seen + 1
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        for key in [*keys[:20], *keys[20:][-2:]]:
            found.append((node, key))
            todo.append(node[key])
    return found


def _with_raw(text: str) -> str:
    for name, raw in RAW.items():
        text = text.replace(f'"{name}"', raw)
    return text


def in_toml(data: bytes, random: Random) -> bytes:
    """TOML written anew from a damaged tree."""
    tree = in_tree(tomllib.loads(data.decode()), random)
    return _with_raw(tomli_w.dumps(tree if isinstance(tree, dict) else {"": tree})).encode(
        errors="surrogatepass"
    )


def in_json(data: bytes, random: Random) -> bytes:
    """JSON written anew from a damaged tree; NaN and infinity as Python writes them."""
    return _with_raw(json.dumps(in_tree(json.loads(data), random))).encode()


def in_safetensors(data: bytes, random: Random) -> bytes:
    """The header, the metadata inside it or the numbers damaged, lengths made right again."""
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    part = random.randrange(4)
    if part == 0:
        header = in_tree(header, random)
    elif part <= 2:
        told = json.loads(header["__metadata__"]["metropilot"])
        header["__metadata__"]["metropilot"] = _with_raw(json.dumps(in_tree(told, random)))
    else:
        at = 4 * random.randrange(max(len(body) // 4, 1))
        numbers = (b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f", b"\xff\xff\x7f\x7f", b"\x01\x00\x00\x00")
        body = body[:at] + random.choice(numbers) * random.choice((1, 8)) + body[at + 4 :]
        body = body[: length and len(data) - 8 - length]
    text = _with_raw(json.dumps(header)).encode()
    return len(text).to_bytes(8, "little") + text + body


def in_csv(data: bytes, random: Random) -> bytes:
    """Cells changed, rows and columns lost or doubled."""
    rows = [line.split(",") for line in data.decode().splitlines()]
    rows = in_tree(rows, random)
    return "\n".join(",".join(map(str, row)) for row in rows if isinstance(row, list)).encode(
        errors="surrogatepass"
    )


def in_bytes(data: bytes, random: Random) -> bytes:
    """Bits flipped, pieces cut, doubled or moved, other encodings."""
    for _ in range(random.choice((1, 1, 2, 5))):
        at, to = random.randrange(len(data) + 1), random.randrange(len(data) + 1)
        change = random.randrange(8)
        if change == 0 and at < len(data):
            data = data[:at] + bytes([data[at] ^ (1 << random.randrange(8))]) + data[at + 1 :]
        elif change == 1:
            data = data[:at]
        elif change == 2:
            data = data[:at] + data[at + random.randrange(1, 9) :]
        elif change == 3:
            data = data[:at] + data[min(at, to) : min(max(at, to), min(at, to) + 200)] + data[at:]
        elif change == 4:
            text = data.decode(errors="replace")
            data = text.encode(random.choice(("utf-16", "utf-8-sig", "utf-32", "cp037")), errors="replace")
        elif change == 5:
            data = (
                data[:at]
                + random.choice((b"9", b"0", b"e", b".", b"-")) * random.choice((1, 20, 400))
                + data[at:]
            )
        else:
            data = data[:at] + random.choice(BYTES) * random.choice((1, 1, 3, 300)) + data[at:]
    return data


KINDS: dict[str, Callable[[bytes, Random], bytes]] = {
    "toml": in_toml,
    "json": in_json,
    "safetensors": in_safetensors,
    "csv": in_csv,
    "text": in_bytes,
}
