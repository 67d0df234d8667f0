"""Options of the packing of groups; its accuracy is measured in benchmarks/accuracy.py, its time in matches.py."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option
from rootmatch.problems.limits import GATE


@dataclass(frozen=True)
class GrowthOptions(Options):
    """How groups grow from single hyper-edges."""

    gate: float = option(GATE, above=0.0)
    """Residual that a hyper-edge outside of the tensor is taken to have: the gate."""
    starts: int = option(20_000, least=1)
    """Maximum number of hyper-edges that grow. A round value, not tuned."""
    per_round: int = option(512, least=1)
    """Groups grown before those within them are skipped. A round value, not tuned."""
    limit: int = option(1_000, least=1)
    """Moves of one ascent. A bound that is never met, not tuned."""


@dataclass(frozen=True)
class CliqueOptions(Options):
    """How groups grow from cliques where whole groups can be fitted."""

    most_cliques: int = option(2_000_000, least=1)
    """Cliques beyond which groups grow from single hyper-edges. A round value, not tuned."""
    large: int = option(7, least=1)
    """Members beyond the order from which chance makes no group, so that its parts need not compete. Not tuned."""
    sampled: int = option(4_096, least=1)
    """Cliques that grow to large groups, of which each has hundreds. A round value, not tuned."""
    per_round: int = option(512, least=1)
    """Cliques that grow before those within large groups are skipped. A round value, not tuned."""
    leading: int = option(64, least=1)
    """Large groups, those of the highest evidence, whose parts are skipped and which are separated from each other. A
    round value, not tuned."""
    per_size: int = option(30_000, least=1)
    """Groups of one size that grow further, those of the highest evidence. A round value, not tuned."""
    least_rest: float = option(0.5, least=0.0, most=1.0)
    """Fraction of a group that must remain without another one's points for the rest to compete. Not tuned."""


@dataclass(frozen=True)
class SelectionOptions(Options):
    """How the groups are selected, by branch and bound."""

    columns: int = option(6_000, least=1)
    """Maximum number of groups that compete, those of the highest evidence. A round value, not tuned."""
    large: int = option(2, least=0)
    """Members beyond the order of a large group, which are selected before all compete. Not tuned."""
    nodes_of_large: int = option(400_000, least=1)
    """Nodes for the best large groups. Some thousand are usual (docs/architecture.md)."""
    nodes: int = option(50_000, least=1)
    """Nodes with the small groups too. A round value, not tuned."""
    nodes_of_rivals: int = option(5_000, least=1)
    """Nodes for the replacement of one group. A round value, not tuned."""
    patience: int = option(150, least=1)
    """Steps without success after which the tabu search that branch and bound begins with ends. Not tuned."""
    rival_overlap: float = option(0.5, least=0.0, most=1.0)
    """Fraction of the smaller of two groups in common from which they are the same one. Not tuned."""
    rival_value: float = option(0.5, least=0.0, most=1.0)
    """Fraction of a group's evidence below which nothing that could take its place is looked for. Not tuned."""


@dataclass(frozen=True)
class PackingOptions(Options):
    """Options of the parts of `GroupPacking`."""

    growth: GrowthOptions = option(GrowthOptions())
    """How groups grow from single hyper-edges."""
    cliques: CliqueOptions = option(CliqueOptions())
    """How groups are made from cliques."""
    selection: SelectionOptions = option(SelectionOptions())
    """How groups are selected."""
