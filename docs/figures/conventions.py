"""Pictures of the page on conventions: axes and segment numbers, signs of wavefront and image."""

import cophase
import matplotlib.pyplot as plt
import numpy as np

from common import image_panel, panel, save, scene


def numbers(axis, model, width_m):
    """The pupil with the number of each segment, from the segment modes themselves."""
    samples = model.samples
    coordinate_m = (np.arange(samples) - (samples - 1) / 2) * width_m / samples
    pupil = np.full((samples, samples), np.nan)
    for segment in range(model.segment_modes):
        unit_nm = model.wavefront_nm(np.eye(model.modes)[segment])[0]
        own = unit_nm > 0.5
        pupil[own] = segment % 3
        y, x = np.nonzero(own)
        axis.text(coordinate_m[x].mean(), coordinate_m[y].mean(), str(segment), ha="center", va="center", fontsize=8)
    half_m = width_m / 2
    axis.imshow(pupil, origin="lower", extent=(-half_m, half_m, -half_m, half_m), cmap="Pastel1", interpolation="nearest")
    axis.annotate("", (half_m, 0), (0, 0), arrowprops={"arrowstyle": "->", "alpha": 0.35})
    axis.annotate("", (0, half_m), (0, 0), arrowprops={"arrowstyle": "->", "alpha": 0.35})
    axis.set_title("Segment numbers, from 0", loc="left", fontsize=9)
    axis.set_xlabel("x (m), columns", fontsize=8)
    axis.set_ylabel("y (m), rows", fontsize=8)


def main():
    model = cophase.Model(scene(modes__ncpa="zernike", modes__ncpa_count=20))
    # A slope needs no diversity to be seen: the spot in focus moves.
    focused = cophase.Model(scene(image__diversity_focus_waves_rms=0, modes__ncpa="zernike", modes__ncpa_count=20))
    mode = focused.mode_names.index
    slope_nm, bump_nm, flat_nm = np.zeros((3, focused.modes))
    slope_nm[mode("noll-2")] = 2168.6
    bump_nm[8] = 300
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.6), layout="constrained")
    numbers(axes[0, 0], model, 10.95)
    panel(axes[0, 1], focused.wavefront_nm(slope_nm)[1], "wavefront that rises along +x")
    middle = np.s_[44:84, 44:84]
    image_panel(axes[0, 2], focused.psf(slope_nm)[middle], "its spot moves along +column")
    for centre in axes[0, 2], axes[1, 2]:
        centre.axhline(20, color="white", linewidth=0.5, alpha=0.6)
        centre.axvline(20, color="white", linewidth=0.5, alpha=0.6)
    panel(axes[1, 0], model.wavefront_nm(bump_nm)[0], "piston of +300 nm on segment 8")
    focus_nm = np.zeros(model.modes)
    focus_nm[mode("noll-4")] = 1.5 * 2168.6
    panel(axes[1, 1], model.wavefront_nm(focus_nm)[1], "diversity of +1.5 waves RMS")
    image_panel(axes[1, 2], focused.psf(flat_nm)[middle], "optical axis: pixel [rows/2, columns/2]")
    y, x = np.unravel_index(focused.psf(flat_nm).argmax(), (focused.pixels, focused.pixels))
    moved = np.unravel_index(focused.psf(slope_nm).argmax(), (focused.pixels, focused.pixels))
    print(f"peak of a flat wavefront: row {y}, column {x}; of the slope: row {moved[0]}, column {moved[1]}; pixels {focused.pixels}")
    save(figure, "conventions.png")


if __name__ == "__main__":
    main()
