"""Make the thumbnails of README.md and docs/tutorials.md from the pictures of the tutorials: make_gallery.py [OUT]

Run the tutorials first; OUT is the folder that they wrote to (default: FEMU_PIEZO_OUT, else out).
"""

import os
import sys
from pathlib import Path

from PIL import Image

#: thumbnail → picture of a tutorial and the part of it to show (left, upper, right, lower; shares of its size)
THUMBNAILS = {
    "k31_plate": ("k31_plate/impedance.png", (0, 0, 1, 1)),
    "sensitivity": ("k31_plate/sensitivity.png", (0, 0, 1, 1)),
    "measured_disk": ("measured_disk/poisson_and_q.png", (0, 0, 1, 1)),
    "full_set": ("full_set/determined.png", (0, 0, 1, 1)),
    "trapezoid": ("trapezoid/mode_02.png", (0, 0, 1, 1)),
    "hidden_effect": ("hidden_effect/diagnosis.png", (0, 0, 1, 1)),
    "stated_uncertainty": ("stated_uncertainty/intervals.png", (0, 0, 1, 0.643)),
    "own_effect": ("own_effect/end_mass.png", (0, 0, 1, 1)),
}
WIDTH, LARGEST = 560, 100_000


def main(out: Path) -> None:
    """Write every thumbnail; those of tutorials that were not run (measured data absent) stay as they are."""
    folder = Path(__file__).parent / "gallery"
    folder.mkdir(exist_ok=True)
    for name, (source, part) in THUMBNAILS.items():
        path = out / source
        if not path.is_file():
            print(f"{name}: {path} does not exist; run that tutorial first")
            continue
        with Image.open(path) as picture:
            size = (picture.width, picture.height) * 2
            cut = picture.convert("RGB").crop(
                tuple(round(share * side) for share, side in zip(part, size, strict=True))
            )
        cut.thumbnail((WIDTH, WIDTH), Image.Resampling.LANCZOS)
        target = folder / f"{name}.png"
        cut.quantize(200).save(target, optimize=True)
        print(f"{target}: {target.stat().st_size} bytes")
        assert target.stat().st_size < LARGEST


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(os.environ.get("FEMU_PIEZO_OUT", "out")))
