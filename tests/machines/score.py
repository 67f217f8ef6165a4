"""Runs the program on drawn machines, holds what it says against what is so, and prints the table.

``python tests/machines/score.py --scenes 200 --jobs 2 --out table.md`` draws fresh seeds and prints them; ``--seed``
gives the same again. The program is used as a user does: its command, and the files that it writes.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import secrets
import shutil
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import numpy as np  # noqa: E402

from machines.bound import bound_of  # noqa: E402  # after the number of threads is set
from machines.draw import CLASSES, draw_machine  # noqa: E402
from machines.folder import write_folder  # noqa: E402
from machines.judge import Judgement, Said, judged  # noqa: E402
from machines.table import INTERVALS, SceneScore, pooled, table_text  # noqa: E402

LONGEST_S = 240.0
"""Seconds after which a run of the program counts as hung."""


@dataclass(frozen=True)
class Scene:
    """What to draw: class and seed."""

    class_name: str
    seed: int


def drawn_scenes(count: int, classes: tuple[str, ...], seed: int) -> list[Scene]:
    """``count`` scenes, the ``classes`` in turn, with seeds that follow from ``seed``."""
    rng = np.random.default_rng(seed)
    return [Scene(classes[place % len(classes)], int(rng.integers(1, 2**31))) for place in range(count)]


def campaign(
    count: int, classes: tuple[str, ...], seed: int, *, jobs: int, intervals: int = 0, told: bool = False
) -> list[SceneScore]:
    """Scores of ``count`` scenes of ``classes`` drawn from ``seed``, ``jobs`` at a time, each ``told`` when done.

    Classes with fewer ``intervals`` than asked get more scenes, up to four times their share.
    """
    scores = score_scenes(drawn_scenes(count, classes, seed), jobs=jobs, told=told)
    most = 4 * -(-count // len(classes))
    for more in range(1, 1000):
        short = tuple(name for name in classes if _is_short(scores, name, intervals, most))
        if not short:
            break
        try:
            scores += score_scenes(drawn_scenes(5 * len(short), short, seed + more), jobs=jobs, told=told)
        except Interrupted as stopped:
            raise Interrupted(scores + stopped.scores) from None
    return scores


def _is_short(scores: list[SceneScore], name: str, intervals: int, most: int) -> bool:
    own = [score for score in scores if score.class_name == name]
    return len(own) < most and pooled(own, INTERVALS).of < intervals


def score_scene(scene: Scene, keep: Path | None = None) -> SceneScore:
    """Draw ``scene``, run the program on it, judge what it says; a crash is a result too.

    With ``keep`` the test and what the program wrote stay in a folder of its own there.
    """
    place = Path(tempfile.mkdtemp(prefix="machine_"))
    if keep is not None:
        place = keep / f"{scene.class_name.replace(' ', '-')}-{scene.seed}"
        shutil.rmtree(place, ignore_errors=True)
    started = time.perf_counter()
    try:
        machine = draw_machine(scene.class_name, scene.seed)
        takes = write_folder(machine, place / "test")
        bound = bound_of(machine)
        began = time.perf_counter()
        message = run_program(place / "test", place / "out")
        seconds = time.perf_counter() - began
        judgements: tuple[Judgement, ...] = ()
        if not message:
            judgements = judged(machine, takes, bound, Said.read(place / "out"))
        return SceneScore(scene.class_name, scene.seed, seconds, message, judgements)
    except Exception as error:  # the scorer's own fault must not end the campaign, and is listed as one
        told = f"scorer: {type(error).__name__}: {error}"
        return SceneScore(scene.class_name, scene.seed, time.perf_counter() - started, told, ())
    finally:
        if keep is None:
            shutil.rmtree(place, ignore_errors=True)


def run_program(folder: Path, out: Path) -> str:
    """Run the program's command on ``folder`` into ``out``, in a process of its own; "" or what went wrong.

    The process is forked after the program is loaded: loading takes longer than the analysis of a small test.
    """
    context = multiprocessing.get_context("fork")
    log = out.with_suffix(".log")
    child = context.Process(target=_command, args=(folder, out, log))
    child.start()
    child.join(LONGEST_S)
    if child.is_alive():
        child.kill()
        child.join()
        return f"no answer in {LONGEST_S:g} s"
    if child.exitcode:
        said = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() if log.exists() else []
        return f"exit status {child.exitcode}: {' | '.join(said[-3:])[:400]}"
    return ""


def _command(folder: Path, out: Path, log: Path) -> None:
    with log.open("w", encoding="utf-8") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
        from crankorder.cli import main, run

        options = [name for option in run.params for name in option.opts]
        bare = ["--no-pictures"] if "--no-pictures" in options else []
        main(["run", str(folder), "--out", str(out), "--jobs", "1", *bare])


def _load_program() -> None:
    import crankorder.batch.execute
    import crankorder.batch.publish  # noqa: F401


def score_scenes(scenes: list[Scene], *, jobs: int, told: bool = False, keep: Path | None = None) -> list[SceneScore]:
    """Scores of ``scenes``, ``jobs`` at a time; each is ``told`` on stderr when done, its files kept in ``keep``."""
    _load_program()
    scores: list[SceneScore] = []
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("fork")) as pool:
        try:
            for score in pool.map(partial(score_scene, keep=keep), scenes):
                scores.append(score)
                if told:
                    _tell(score, f"{len(scores)}/{len(scenes)}")
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise Interrupted(scores) from None
    return scores


class Interrupted(Exception):  # no error: the user has seen enough
    """Ctrl-C; ``scores`` are those that were done."""

    def __init__(self, scores: list[SceneScore]) -> None:
        """Keep ``scores``."""
        super().__init__("interrupted")
        self.scores = scores


def _tell(score: SceneScore, place: str) -> None:
    state = score.message or f"{sum(not one.good for one in score.marks)} wrong"
    print(f"{place} {score.class_name} {score.seed}: {state}", file=sys.stderr, flush=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=200, help="how many machines")
    parser.add_argument("--classes", nargs="+", default=list(CLASSES), choices=CLASSES, help="which classes")
    parser.add_argument("--seed", type=int, help="draws the same machines again; left out: fresh ones")
    parser.add_argument("--scene-seed", type=int, nargs="+", help="these machines alone, by their own seeds")
    parser.add_argument("--intervals", type=int, default=0, help="more scenes until every class has so many intervals")
    parser.add_argument("--jobs", type=int, default=2, help="scenes at a time")
    parser.add_argument("--keep", type=Path, help="with --scene-seed: folder in which tests and results are kept")
    parser.add_argument("--out", type=Path, help="file for the table")
    parser.add_argument("--json", type=Path, help="file for every judgement")
    asked = parser.parse_args()
    seed = secrets.randbits(31) if asked.seed is None else asked.seed
    try:
        if asked.scene_seed:
            scenes = [Scene(name, one) for name in asked.classes for one in asked.scene_seed]
            scores = score_scenes(scenes, jobs=asked.jobs, told=True, keep=asked.keep)
        else:
            classes = tuple(asked.classes)
            scores = campaign(asked.scenes, classes, seed, jobs=asked.jobs, intervals=asked.intervals, told=True)
    except Interrupted as stopped:
        scores = stopped.scores
    text = table_text(scores, seed=seed)
    print(text)
    if asked.out:
        asked.out.write_text(text, encoding="utf-8")
    if asked.json:
        asked.json.write_text(json.dumps([score.plain() for score in scores], indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
