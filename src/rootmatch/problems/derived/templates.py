"""The loops of derived problems, with places for what a problem's plan decides; see `residuals`."""

from __future__ import annotations


def fill_template(template: str, parts: dict[str, str | list[str]]) -> str:
    """Put parts into a template: ``<NAME>`` alone on a line takes lines at its indentation, elsewhere a text."""
    out = []
    for line in template.splitlines():
        bare = line.strip()
        lines = parts.get(bare[1:-1]) if bare.startswith("<") and bare.endswith(">") else None
        if isinstance(lines, list):
            indent = line[: len(line) - len(line.lstrip())]
            out += [indent + inner for inner in lines]
            continue
        for name, text in parts.items():
            if isinstance(text, str):
                line = line.replace(f"<{name}>", text)
        out.append(line)
    return "\n".join(out) + "\n"


EDGE = """
@kernel
def edge_<KIND>(t, kind, i, j):
    worst = 0.0
    for pair in range(len(ORDERS)):
        if kind.pairs >> pair & 1:
            o = ORDERS[pair]
            worst = max(worst, pair_<KIND>(t, <PERMUTED>))
    return worst


@kernel
def slab_<KIND>(t, kind, i, j, first, scratch, out):
    rows, targets = out.shape
    if kind.pairs != 1:
        for r in range(rows):
            i[-1] = first + r
            for k in range(targets):
                j[-1] = k
                out[r, k] = edge_<KIND>(t, kind, i, j)
        return
"""

ROOTS = """
    <VIEWS>
    least = BIG
    <C> = polynomial<FIRST>(t, <BASES>)
    for x in find_roots(<C>):
        <CORE>
        <HOIST>
        least = min(least, <SQUARE>)
    return math.sqrt(least)
"""

SWEEP = """
    <VIEWS>
    out[:] = BIG
    d = first
    <C> = polynomial<FIRST>(t, <BASES>)
    for x in find_roots(<C>):
        <CORE>
        for row in range(rows):
            d = first + row
            line = out[row]
            <HOIST>
            for k in range(targets):
                line[k] = min(line[k], <SQUARE>)
    for row in range(rows):
        line = out[row]
        for k in range(targets):
            line[k] = math.sqrt(line[k])
"""

NORMALISED = f"""
@kernel
def pair_<KIND>(t, <BASES>, d, k):{ROOTS}
{EDGE}    <UNPACK>{SWEEP}"""

JOINT = f"""
@kernel
def edge_joint(t, kind, i, j):
    <UNPACK>
    d = i[<LAST>]
    k = j[<LAST>]
    <FIND>{ROOTS}

@kernel
def slab_joint(t, kind, i, j, first, scratch, out):
    rows, targets = out.shape
    <UNPACK>
    <FIND>{SWEEP}"""

ALONE = """
@kernel
def edge_joint(t, kind, i, j):
    return edge_normalised(t, ONE, i, j)


@kernel
def slab_joint(t, kind, i, j, first, scratch, out):
    slab_normalised(t, ONE, i, j, first, scratch, out)
"""

RESULTANT = f"""
@kernel
def pair_<KIND>(t, <BASES>, d, k):
    <P> = polynomial(<FIRST>)
    <Q> = polynomial(<SECOND>)
    one = ordinary(<LARGEST>)
    <UNITS>
    <UNITS_OF_BOTH>
    return compare_<KIND>(<P>, <Q>)

{EDGE}    <UNPACK>
    <P> = polynomial(<FIRST>)
    one = ordinary(<LARGEST>)
    <UNITS>
    <VIEWS>
    for r in range(rows):
        d = first + r
        line = out[r]
        (<HOISTED>,) = row(<LOADS>)
        <UNITS_OF_ROW>
        for k in range(targets):
            <POWERS>
            line[k] = compare_<KIND>(<P>, <Q>)
"""
