"""Make `reports/gallery/`: pictures of the reference campaign, a run-up and a crank-angle test, from their scenes.

Usage: python reports/make_gallery.py
Synthesises the scenes in a temporary folder, analyses them with the command line and copies the pictures.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

GALLERY = Path(__file__).parent / "gallery"
SCENES = {
    "steady-sweep": ("thesis-second-motoring", "The reference campaign: 35 speeds, 300…2000 rpm, sampled by time"),
    "run-up": ("run-up", "A run-up: four cylinders in line, 300…6000 rpm in a minute, a 60-2 wheel"),
    "crank-angle": ("thesis-first-motoring", "Four speeds, sampled once per degree of crank angle"),
}


def crankorder(*arguments: str) -> None:
    """Run the command line; its faults are shown and end the making."""
    subprocess.run([sys.executable, "-m", "crankorder", *arguments], check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    lines = ["# Gallery", "", "Made by `make gallery` from synthesised recordings; made again, the bytes are the same."]
    with tempfile.TemporaryDirectory() as scratch:
        for kind, (scene, caption) in SCENES.items():
            recordings, out = Path(scratch) / scene, Path(scratch) / f"{scene}-results"
            crankorder("synth", scene, "--out", str(recordings), "-q")
            crankorder("run", str(recordings), "--out", str(out), "--recipe", "waveforms", "-q")
            target = GALLERY / kind
            shutil.rmtree(target, ignore_errors=True)
            target.mkdir(parents=True)
            lines += ["", f"## {caption}", "", f"Scene `{scene}`."]
            for picture in sorted(out.glob("*/*.png")):
                shutil.copy(picture, target / picture.name)
                lines += ["", f"![{picture.stem}]({kind}/{picture.name})"]
    (GALLERY / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
