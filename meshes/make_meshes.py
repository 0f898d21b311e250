"""Make the ready meshes of this folder with gmsh through pygmsh: python meshes/make_meshes.py

Each file is the unit box with named faces x_min … z_max; `femu_piezo.geometry.boxes.unit_box` scales it to a plate.
"""

from pathlib import Path

from femu_piezo.geometry.boxes import write_unit_box

#: What each division serves.
BOXES = {
    (3, 1, 1): "plates and bars to their first overtones, one eighth, order 3 to 6",
    (4, 1, 1): "the same, for more accuracy or a wider band",
    (5, 1, 1): "the same",
    (6, 1, 1): "k31 plate 40 x 5 x 1 mm, one eighth, order 5, to 300 kHz (default accuracy)",
    (8, 1, 1): "k31 plate 40 x 5 x 1 mm, one eighth, order 5, to 300 kHz at 1e-5",
    (7, 1, 1): "k31 plate 40 x 5 x 1 mm, one eighth, quadratic, fundamental",
    (12, 1, 1): "slender k33 bar, one eighth, fundamental",
    (20, 3, 1): "k31 plate 40 x 5 x 1 mm, one eighth, to 300 kHz at 5e-4",
    (40, 8, 4): "k31 plate 40 x 5 x 1 mm, whole, 1 mm linear hexahedra of the paper",
    (6, 6, 6): "VM175 cube, one eighth",
    (8, 2, 1): "measured k31 bar 12 x 3 x 1 mm, one eighth",
}

if __name__ == "__main__":
    for divisions, purpose in BOXES.items():
        path = Path(__file__).parent / f"box_{'x'.join(map(str, divisions))}.msh"
        write_unit_box(divisions, path)
        print(f"{path.name}: {purpose}, {path.stat().st_size / 1024:.0f} KiB")
