"""Loops that compiled code holds twice, as vector code and as plain code, one of which is taken by where arrays lie."""

import re

# Arithmetic of which the compiler may change the order or the rounding.
FAST_ARITHMETIC = re.compile(r"= f(?:add|sub|mul|div|neg)\b[^%]*\b(?:reassoc|contract|arcp)\b")


def functions(module):
    """Name and blocks {label: lines} of each function of optimised LLVM code that is called as such; those marked to be
    inlined are in their callers."""
    inlined = set(re.findall(r"attributes (#\d+) = \{[^}]*\balwaysinline\b", module))
    for head, body in re.findall(r"^(define [^\n]*)\{\n(.*?)^\}", module, re.MULTILINE | re.DOTALL):
        if inlined.isdisjoint(head.split()):
            parts = re.split(r"^([\w.$-]+):", "entry:" + body, flags=re.MULTILINE)
            yield (
                re.search(r'@"?([^"(]*)', head)[1],
                {k: v.splitlines() for k, v in zip(parts[1::2], parts[2::2], strict=True)},
            )


def loops_by_address(module):
    """(function, arithmetic) of every such loop that would round differently in its two versions."""
    for name, blocks in functions(module):
        for label in blocks:
            if label.startswith("vector.memcheck"):
                # On the way to the plain loop no block is named after vectors.
                reached, ahead = set(), [label]
                while ahead:
                    at = ahead.pop()
                    reached.add(at)
                    following = re.findall(r"label %([\w.$-]+)", "\n".join(blocks[at]))
                    ahead += [b for b in following if "vec" in b and b not in reached]
                lines = [line for block in reached for line in blocks[block] if FAST_ARITHMETIC.search(line)]
                if lines:
                    yield name, lines
