"""Make `reports/gallery/`: pictures of tests and of a comparison, from their scenes.

Usage: python reports/make_gallery.py
Synthesises the scenes in a temporary folder, analyses and compares them with the command line and copies the pictures,
in fewer colours. `reports/gallery/thesis` is made by `reports/make_thesis.py`.
"""

from __future__ import annotations

import io
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
    "as-compared": ("thesis-second-compared", "The same four speeds after a change: second-order balance shafts"),
}
COMPARED = ("crank-angle", "as-compared")
COLORS = 256
"""Of a copied picture: a third of the bytes, and no colour that the eye would miss."""


def copy_picture(source: Path, target: Path) -> None:
    """The picture ``source`` of fewer colours at ``target``, whose folder is made."""
    from PIL import Image

    with Image.open(source) as image:
        small = image.convert("RGB").quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        data = io.BytesIO()
        small.save(data, "png", optimize=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(data.getvalue())


def crankorder(*arguments: str) -> None:
    """Run the command line; its faults are shown and end the making."""
    subprocess.run([sys.executable, "-m", "crankorder", *arguments], check=True, stdout=subprocess.DEVNULL)


def section(pictures: list[Path], kind: str, caption: str, made_by: str) -> list[str]:
    """Lines of the page for the folder ``kind``, whose ``pictures`` are copied."""
    shutil.rmtree(GALLERY / kind, ignore_errors=True)
    lines = ["", f"## {caption}", "", made_by]
    for picture in pictures:
        copy_picture(picture, GALLERY / kind / picture.name)
        lines += ["", f"![{picture.stem}]({kind}/{picture.name})"]
    return lines


def main() -> None:
    """Make the whole gallery but for the thesis."""
    lines = ["# Gallery", "", "Made by `make gallery` from synthesised recordings; made again, the bytes are the same.",
             "Pictures of the source documents: [the thesis, page by page](../../docs/thesis.md)."]  # fmt: skip
    results: dict[str, Path] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for kind, (scene, caption) in SCENES.items():
            recordings, out = Path(scratch) / scene, Path(scratch) / f"{scene}-results"
            crankorder("synth", scene, "--out", str(recordings), "-q")
            crankorder("run", str(recordings), "--out", str(out), "--recipe", "waveforms", "-q")
            shutil.rmtree(recordings)
            results[kind] = next(out.glob("*/done.json")).parent
            if kind != COMPARED[1]:
                lines += section(sorted(results[kind].glob("*.png")), kind, caption, f"Scene `{scene}`.")
        out = Path(scratch) / "difference"
        crankorder("compare", *(str(results[kind]) for kind in COMPARED), "--out", str(out))
        said = f"`crankorder compare` of the scenes {' and '.join(f'`{SCENES[kind][0]}`' for kind in COMPARED)}."
        lines += section(sorted(out.glob("*.png")), "comparison", "Two builds compared", said)
    (GALLERY / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
