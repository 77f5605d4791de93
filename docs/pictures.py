"""Draw the picture of docs/how-to/uncertainty.md: ``python docs/pictures.py [FOLDER]``.

Heights, flag and standard error of the sample town, whose houses are gaps and whose lake is level.
Needs the extras ``figures`` and ``vector``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
import rasterio

import volatool as vt

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.colors import LightSource, ListedColormap, LogNorm, Normalize

HERE = Path(__file__).resolve().parent
SAMPLES = HERE.parent / "data_samples"
FLAGS = ("void", "measured", "filled")


def layer(folder: Path, name: str) -> np.ndarray:
    """Return a raster, NaN for nodata."""
    with rasterio.open(folder / f"town.dem{name}.tif") as file:
        return np.asarray(file.read(1, masked=True).astype(float).filled(np.nan))


def main() -> None:
    """Run from the command line."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "how-to"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        vt.convert(
            SAMPLES / "town.laz", outdir=folder, cell="1m", layers=("flag", "sigma"), dense="never",
            water=str(SAMPLES / "town-lake.geojson"), resources=False,
        )  # fmt: skip
        z, flag, sigma = (layer(folder, name) for name in ("", ".flag", ".sigma"))
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.3), layout="constrained")
    relief = plt.get_cmap("gist_earth")
    shaded = LightSource(315, 45).shade(
        np.nan_to_num(z, nan=np.nanmin(z)), relief, blend_mode="soft", vert_exag=2
    )
    axes[0].imshow(shaded)
    tint = plt.cm.ScalarMappable(Normalize(np.nanmin(z), np.nanmax(z)), relief)
    figure.colorbar(tint, ax=axes[0], shrink=0.8, label="height, m")
    axes[0].set_title("heights: bare earth, the lake level")
    colours = ListedColormap(["#ffffff", "#3b6ea5", "#f0a830"])
    drawn = axes[1].imshow(flag, colours, vmin=-0.5, vmax=2.5)
    bar = figure.colorbar(drawn, ax=axes[1], shrink=0.8, ticks=range(3))
    bar.set_ticklabels(FLAGS)
    axes[1].set_title("flag: houses and lake are filled")
    drawn = axes[2].imshow(sigma, "viridis", norm=LogNorm())
    figure.colorbar(drawn, ax=axes[2], shrink=0.8, label="standard error, m")
    axes[2].set_title("sigma: grows into the gaps")
    for ax in axes:
        ax.set_xticks([])
        ax.set_yticks([])
        ax.set_xlabel(f"{z.shape[1]} m")
    path = target / "uncertainty.png"
    figure.savefig(path, dpi=80, metadata={"Software": None})
    print(path)


if __name__ == "__main__":
    main()
