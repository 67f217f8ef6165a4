"""The table of a campaign: how often each kind of statement was right, by class and in all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from machines.judge import Judgement

MARKS = (
    "dangerous not free",
    "lock",
    "strongest",
    "mode found",
    "mode real",
    "rows",
    "consistent",
)
"""Kinds whose every miss is a fault."""
INTERVALS = ("amplitude", "phase", "frequency", "damping")
DECIDED = ("decided: free", "decided: lock", "decided: mode")
MORE = (
    "dangerous range not free",
    "dangerous named",
    "order found",
    "order real",
    "amplitude, transient",
    "amplitude, steady",
)
WORST = 12
"""Words per kind that the list of faults holds."""


@dataclass(frozen=True)
class SceneScore:
    """One scene: what it was, how long the program took, how it failed ("" where it did not), all judgements."""

    class_name: str
    seed: int
    seconds: float
    message: str
    judgements: tuple[Judgement, ...]

    @property
    def marks(self) -> list[Judgement]:
        """Judgements of the kinds whose every miss is a fault."""
        return [one for one in self.judgements if one.kind in MARKS]

    def plain(self) -> dict[str, Any]:
        """As JSON holds it."""
        judged = [[one.kind, one.good, one.of, one.words] for one in self.judgements]
        return {"class": self.class_name, "seed": self.seed, "message": self.message, "judgements": judged}


@dataclass(frozen=True)
class Share:
    """How much of a kind was good: ``good`` of ``of``."""

    good: float
    of: float

    @property
    def share(self) -> float:
        """Between 0 and 1; 1 where nothing was asked."""
        return self.good / self.of if self.of else 1.0

    def text(self, *, misses: bool) -> str:
        """As the table shows it: misses of how many, or the share in per cent of how many."""
        if not self.of:
            return "–"
        if misses:
            return f"{self.of - self.good:.0f} / {self.of:.0f}"
        return f"{100.0 * self.share:.1f} ({self.of:.0f})"


def share_of(scores: Iterable[SceneScore], kind: str) -> Share:
    """Share of ``kind`` pooled over ``scores``."""
    own = [one for score in scores for one in score.judgements if one.kind == kind]
    return Share(sum(one.good for one in own), sum(one.of for one in own))


def pooled(scores: list[SceneScore], kinds: Iterable[str]) -> Share:
    """Share of all ``kinds`` of ``scores`` together."""
    parts = [share_of(scores, kind) for kind in kinds]
    return Share(sum(part.good for part in parts), sum(part.of for part in parts))


def table_text(scores: list[SceneScore], *, seed: int) -> str:
    """The campaign of ``scores`` as Markdown: marks, coverage, what was decided, faults, and the ``seed``."""
    classes = list(dict.fromkeys(score.class_name for score in scores))
    groups = [(name, [score for score in scores if score.class_name == name]) for name in classes]
    groups.append(("all", scores))
    crashed = [score for score in scores if score.message]
    seconds = sum(score.seconds for score in scores) / max(1, len(scores))
    lines = [
        f"{len(scores)} machines, seed {seed}; {len(crashed)} failed; {seconds:.1f} s each for the program.",
        "",
        "Wrong statements / statements:",
        "",
        *_table(groups, MARKS, misses=True),
        "",
        "95 % intervals that cover, % (intervals):",
        "",
        *_table(groups, (*INTERVALS, "pooled"), misses=False),
        "",
        "Decided, % of what an estimator that knows the model decides:",
        "",
        *_table(groups, DECIDED, misses=False),
        "",
        "More, %:",
        "",
        *_table(groups, MORE, misses=False),
        "",
        *_faults(scores),
        "Seeds: " + ", ".join(f"{score.class_name} {score.seed}" for score in scores),
    ]
    return "\n".join(lines) + "\n"


def _table(groups: list[tuple[str, list[SceneScore]]], kinds: tuple[str, ...], *, misses: bool) -> list[str]:
    lines = ["| class | scenes | " + " | ".join(kinds) + " |", "|---" * (len(kinds) + 2) + "|"]
    for name, own in groups:
        shares = [pooled(own, INTERVALS) if kind == "pooled" else share_of(own, kind) for kind in kinds]
        cells = [share.text(misses=misses) for share in shares]
        lines.append(f"| {name} | {len(own)} | " + " | ".join(cells) + " |")
    return lines


def _faults(scores: list[SceneScore]) -> list[str]:
    """Failures of the program, then some wrong statements of every kind, each with its class and seed."""
    lines = [f"* failed: {one.class_name} {one.seed}: {one.message}" for one in scores if one.message]
    for kind in (*MARKS, *INTERVALS):
        wrong = [(score, one) for score in scores for one in score.judgements if one.kind == kind and not one.good]
        by_scene: dict[tuple[str, int], str] = {}
        for score, one in wrong:
            by_scene.setdefault((score.class_name, score.seed), one.words)
        lines += [f"* {kind}: {name} {seed}: {words}" for (name, seed), words in list(by_scene.items())[:WORST]]
    return [*lines, ""] if lines else []
