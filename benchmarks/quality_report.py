"""The quality report against planted faults: every one named, with its seconds, and none besides.

    python benchmarks/quality_report.py ../shared/data/walks/house/leader ../shared/data/walks/kitchen/leader

Faults are planted at random places of each walk: darkness, blur, a blank wall. ``--build`` makes whole
maps; without it only pictures and features are looked at, which is all that these reasons rest on.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from clips import write_pictures
from judged_pictures import judge_video, read_pictures
from planted_faults import Fault, draw_faults, plant

from server.evaluation.walk import Walk, read_walk
from server.mapping.build import build_route_map
from server.mapping.quality import QualityReport
from server.mapping.video import probe


@dataclass(frozen=True)
class Trial:
    """A walk with faults, and what was said of it."""

    walk: str
    faults: Sequence[Fault]
    report: QualityReport
    fps: float

    @property
    def errors(self) -> list[float | None]:
        """For each fault the worse of its two edges, seconds; None if it was not named."""
        errors: list[float | None] = []
        for fault in self.faults:
            begin, end = fault.begin / self.fps, fault.end / self.fps
            named = [
                max(abs(s.start_s - begin), abs(s.end_s - end))
                for s in self.report.stretches
                if s.reason == fault.reason and s.start_s < end and s.end_s > begin
            ]
            errors.append(min(named, default=None))
        return errors

    @property
    def false(self) -> int:
        """Stretches besides the planted ones."""
        return len(self.report.stretches) - sum(error is not None for error in self.errors)


def run_trial(walk: Walk, pictures: list[np.ndarray], faults: list[Fault], seed: int, build: bool) -> Trial:
    """Plant, film, judge."""
    fps = probe(walk.video).frame_rate
    with tempfile.TemporaryDirectory() as folder:
        planted = list(plant(pictures, faults, np.random.default_rng([seed, 1])))
        video = write_pictures(Path(folder) / "video.mp4", planted, fps)
        if build:
            report = build_route_map(video, walk.camera).quality
            if report is None:
                raise RuntimeError(f"{walk.folder}: no report")
        else:
            report = judge_video(video, walk.camera)
    return Trial(str(Path(*walk.folder.parts[-2:])), faults, report, fps)


def main() -> None:
    """Run all trials, print a line for each, and a table by kind of fault."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("walks", nargs="+", type=Path)
    parser.add_argument("--seeds", type=int, default=4, help="trials for every length of fault and walk")
    parser.add_argument("--seconds", type=float, nargs="+", default=[1.0, 2.0, 4.0])
    parser.add_argument("--build", action="store_true", help="make whole maps")
    parser.add_argument("--json", type=Path, help="write the figures there")
    options = parser.parse_args()
    trials = []
    for folder in options.walks:
        walk = read_walk(folder)
        pictures = read_pictures(walk.video)
        clean = run_trial(walk, pictures, [], 0, options.build)
        print(f"{clean.walk}, as it is: {clean.false} stretches, score {clean.report.score}", flush=True)
        trials.append(clean)
        for seconds in options.seconds:
            for seed in range(options.seeds):
                rng = np.random.default_rng([seed, round(10 * seconds)])
                fps = probe(walk.video).frame_rate
                try:
                    faults = draw_faults(len(pictures), fps, seconds, rng, adjacent=seed % 2 == 1)
                except ValueError:
                    continue
                trial = run_trial(walk, pictures, faults, seed, options.build)
                trials.append(trial)
                wrong = None in trial.errors or trial.false > 0
                said = ", ".join(
                    f"{f.kind} {f.begin / fps:.1f}-{f.end / fps:.1f}: "
                    + ("MISSED" if e is None else f"{e:.2f} s")
                    for f, e in zip(faults, trial.errors, strict=True)
                )
                told = f"; told: {[(s.reason.value, s.start_s, s.end_s) for s in trial.report.stretches]}"
                print(
                    f"{trial.walk} {seconds:g} s: {said}; false {trial.false}{told if wrong else ''}",
                    flush=True,
                )
    summary = summarised(trials)
    print(json.dumps(summary, indent=1))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")


def summarised(trials: list[Trial]) -> dict[str, object]:
    """Counts over all trials, and for every kind of fault."""
    pairs = [(f, e) for t in trials for f, e in zip(t.faults, t.errors, strict=True)]
    kinds = {}
    for kind in sorted({fault.kind for fault, _ in pairs}):
        errors = [e for f, e in pairs if f.kind == kind]
        known = [e for e in errors if e is not None]
        kinds[kind] = {
            "planted": len(errors),
            "named": len(known),
            "worst_edge_s": round(max(known), 3) if known else None,
        }
    return {
        "videos": len(trials),
        "planted": len(pairs),
        "named": sum(e is not None for _, e in pairs),
        "within_0.3_s": sum(e is not None and e <= 0.3001 for _, e in pairs),
        "false": sum(t.false for t in trials),
        "kinds": kinds,
    }


if __name__ == "__main__":
    main()
