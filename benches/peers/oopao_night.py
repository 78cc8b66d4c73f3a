#!/usr/bin/env python3
"""A night behind adaptive optics simulated by OOPAO, read by `cophase estimate --method full-phase`: residuals and error bars.

    python3 benches/peers/oopao_night.py --program target/release/cophase --seeds 3 --output nights

needs oopao 1.0.0 and astropy. OOPAO makes turbulence, telescope, mirror, sensor, interaction matrix, slopes and images, in its own units
(slopes in pixels of its sensor, commands in metres); the pupil's hexagons, the pseudo-inverse and the draws of the aberrations are NumPy's.
A night takes some 5 minutes on one core. Its files are in a folder of --output, and a night that is there is not simulated again.
"""

import argparse
import contextlib
import io
import math
from pathlib import Path

import numpy as np
from astropy.io import fits
from program import report

with contextlib.redirect_stdout(io.StringIO()):
    from OOPAO.Atmosphere import Atmosphere
    from OOPAO.calibration.InteractionMatrix import InteractionMatrix
    from OOPAO.DeformableMirror import DeformableMirror
    from OOPAO.Detector import Detector
    from OOPAO.OPD_map import OPD_map
    from OOPAO.ShackHartmann import ShackHartmann
    from OOPAO.Source import Source
    from OOPAO.Telescope import Telescope
    from OOPAO.Zernike import Zernike

LENSLETS, SAMPLES, WIDTH_M, FRAME_S, EXPOSURE_FRAMES = 20, 240, 11.25, 1e-3, 10
# Singular values below the largest over CONDITION are left out: with all but two the mirror runs away within a second.
GAIN, COUPLING, CONDITION, SETTLE_FRAMES, PAUSE_FRAMES = 0.3, 0.35, 30.0, 200, 40
DEFOCUS_WAVES_RMS, PISTON_RMS_NM, NCPA_RMS_NM, NOLL = 1.5, 64.0, 72.7, range(4, 19)
READ_NOISE_E, PIXELS = 60.0, 240

SCENE = """\
# A night of OOPAO: its own units and matrices.
[pupil]
file = "pupil.fits"
grid_m = {width}
samples = {samples}

[image]
wavelength_nm = {wavelength}
samples_per_lambda_over_d = 2
pixels = {pixels}
exposure_s = {exposure}
diversity_focus_waves_rms = {defocus}
read_noise_e = {read_noise}

[modes]
segment = "piston"
ncpa = "kl"
ncpa_count = 66

[turbulence]
r0_m = 0.16
outer_scale_m = 50.0

[mirror]
actuators_across = {actuators}
pitch_m = {pitch}
coupling = {coupling}
actuator_file = "actuators.txt"

[wavefront_sensor]
lenslets_across = {lenslets}
subaperture_file = "subapertures.txt"
wavelength_nm = {sensing}
detector = "pixels"
pixels_per_lenslet = {spot_pixels}
slope_unit_mas = {slope_unit}

[control]
gain = {gain}
frame_rate_hz = {rate}
interaction_file = "interaction.fits"
command_matrix_file = "command.fits"
matrix_command_nm = 1e9           # commands of OOPAO are metres
"""


def keck_pupil(samples):
    """Owner of each sample: hexagons of 0.9 m in three rings without the central one; -1 outside."""
    at = ((np.arange(samples) + 0.5) / samples - 0.5) * WIDTH_M
    x, y = np.meshgrid(at, at)
    owner, pitch, number = np.full((samples, samples), -1), math.sqrt(3) * 0.9 + 0.003, 0
    for i in range(-3, 4):
        for j in range(-3, 4):
            if abs(i + j) > 3 or (i, j) == (0, 0):
                continue
            dx, dy = x - pitch * math.sqrt(3) / 2 * i, y - pitch * (j + i / 2)
            across = [abs(dx * math.cos(a) + dy * math.sin(a)) for a in np.radians([30, 90, 150])]
            owner[np.max(across, axis=0) <= math.sqrt(3) / 2 * 0.9] = number
            number += 1
    return owner


def write(path, hdus):
    """FITS images of a dictionary `name: (array, unit)`."""
    primary = [fits.PrimaryHDU()]
    for name, (values, unit) in hdus.items():
        hdu = fits.ImageHDU(np.asarray(values, dtype=np.float64 if values.dtype.kind == "f" else np.int32), name=name)
        hdu.header["GRID_M"] = WIDTH_M
        if unit:
            hdu.header["BUNIT"] = unit
        primary.append(hdu)
    fits.HDUList(primary).writeto(path, overwrite=True)


def mask_text(mask):
    """Lines of 0 and 1, the smallest y first."""
    return "\n".join(" ".join("01"[int(used)] for used in row) for row in mask) + "\n"


class Night:
    """Telescope and loop of OOPAO; `run` makes the files of one seed."""

    def __init__(self):
        self.owner = keck_pupil(SAMPLES)
        self.lit = self.owner >= 0
        self.guide, self.star = Source("R", 4.0), Source("K", 1.8)
        self.tel = Telescope(SAMPLES, WIDTH_M, samplingTime=FRAME_S, pupil=self.lit.astype(float))
        self.guide**self.tel
        layers = {"fractionalR0": [0.517, 0.119, 0.063, 0.061, 0.105, 0.081, 0.054],
                  "altitude": [0, 500, 1000, 2000, 4000, 8000, 16000],
                  "windSpeed": [6.8, 6.9, 7.1, 7.5, 10.0, 26.9, 18.5],
                  "windDirection": [0, 90, 45, 270, 120, 22, 180]}
        self.atm = Atmosphere(self.tel, r0=0.16, L0=50.0, **layers)
        self.atm.initializeAtmosphere(self.tel)
        # A threshold, OOPAO's default, makes slopes jump at pixels that are as bright.
        self.wfs = ShackHartmann(LENSLETS, self.tel, lightRatio=0.5, threshold_cog=0.0)
        self.dm = DeformableMirror(self.tel, LENSLETS, mechCoupling=COUPLING, actuator_selection=0.2)
        self.interaction = InteractionMatrix(self.guide, self.tel, self.dm, self.wfs, np.eye(self.dm.nValidAct), stroke=1e-8,
                                             nMeasurements=20, single_pass=False, invert=False).D
        u, s, v = np.linalg.svd(self.interaction, full_matrices=False)
        kept = s > s[0] / CONDITION
        self.command = (v[kept].T / s[kept]) @ u[:, kept].T

    def scene(self):
        wfs, dm = self.wfs, self.dm
        return SCENE.format(
            width=WIDTH_M, samples=SAMPLES, wavelength=self.star.wavelength * 1e9, pixels=PIXELS, exposure=FRAME_S * EXPOSURE_FRAMES,
            defocus=DEFOCUS_WAVES_RMS, read_noise=READ_NOISE_E, actuators=dm.nAct, pitch=dm.pitch, coupling=dm.mechCoupling,
            lenslets=LENSLETS, sensing=wfs.src.wavelength * 1e9, spot_pixels=wfs.n_pix_subap,
            slope_unit=wfs.pixel_scale * 1e3, gain=GAIN, rate=1 / FRAME_S)

    def run(self, seed, count, folder):
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(seed)
        piston = rng.normal(size=36)
        piston = (piston - piston.mean()) * PISTON_RMS_NM / piston.std()
        segments = np.where(self.lit, piston[self.owner], 0.0)
        zernike = Zernike(self.tel, 20)
        zernike.computeZernike(self.tel)
        modes = zernike.modesFullRes  # Noll 2 and on, RMS 1 in the pupil
        orders = [math.ceil((math.sqrt(8 * noll + 1) - 3) / 2) for noll in NOLL]
        ncpa = sum(rng.normal() / order * modes[:, :, noll - 2] for noll, order in zip(NOLL, orders))
        ncpa *= NCPA_RMS_NM / ncpa[self.lit].std()
        mirror_side, science_side = OPD_map(segments * 1e-9), OPD_map(
            ncpa * 1e-9 + DEFOCUS_WAVES_RMS * self.star.wavelength * modes[:, :, 2])
        camera = Detector(PIXELS, integrationTime=FRAME_S * EXPOSURE_FRAMES, psf_sampling=2, photonNoise=True,
                          readoutNoise=READ_NOISE_E)
        self.wfs.cam.photonNoise, self.wfs.cam.readoutNoise = True, 0.4
        for k, detector in enumerate((camera, self.wfs.cam)):
            detector.random_state_photon_noise = np.random.RandomState(1000 * seed + k)
            detector.random_state_readout_noise = np.random.RandomState(1000 * seed + 10 + k)
        self.atm.generateNewPhaseScreen(seed)
        self.dm.coefs = np.zeros(self.dm.nValidAct)
        images, slopes, commands, sums = [], [], [], []
        frame_sum = np.zeros(self.wfs.nSignal)
        period = EXPOSURE_FRAMES + PAUSE_FRAMES
        for frame in range(SETTLE_FRAMES + count * period - PAUSE_FRAMES):
            self.atm.update()
            self.guide**self.atm * self.tel * mirror_side * self.dm * self.wfs
            step = frame - SETTLE_FRAMES
            if step >= 0 and step % period < EXPOSURE_FRAMES:
                frame_sum += self.wfs.signal
                self.star**self.atm * self.tel * mirror_side * self.dm * science_side * camera
                if step % period == EXPOSURE_FRAMES - 1:
                    images.append(np.array(camera.frame, dtype=float))
                    slopes.append(frame_sum / EXPOSURE_FRAMES)
                    commands.append(self.dm.coefs.copy())
                    frame_sum = np.zeros(self.wfs.nSignal)
                    # The next exposure is some other minute's: its turbulence is drawn anew, and the loop settles on it.
                    self.atm.generateNewPhaseScreen(1000 * seed + len(images))
            self.dm.coefs = self.dm.coefs - GAIN * self.command @ self.wfs.signal
        write(folder / "night.fits", {"IMAGES": (np.array(images), "electron"), "SLOPES_MEAN": (np.array(slopes), ""),
                                      "COMMANDS": (np.array(commands), "m")})
        write(folder / "truth.fits", {"TRUTH_PHASING": (segments, "nm"), "TRUTH_NCPA": (np.where(self.lit, ncpa, 0.0), "nm")})
        write(folder / "pupil.fits", {"PUPIL": (self.lit.astype(float), ""), "SEGMENT": (self.owner, "")})
        write(folder / "interaction.fits", {"INTERACTION": (self.interaction, "")})
        write(folder / "command.fits", {"COMMAND_MATRIX": (self.command, "")})
        (folder / "subapertures.txt").write_text(mask_text(self.wfs.valid_subapertures.reshape(LENSLETS, LENSLETS)))
        used = np.zeros(self.dm.nAct**2, dtype=bool)
        used[self.dm.validAct] = True
        (folder / "actuators.txt").write_text(mask_text(used.reshape(self.dm.nAct, -1)))
        (folder / "scene.toml").write_text(self.scene())  # last: a night with a scene is complete


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", required=True)
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--images", type=int, default=60)
    arguments.add_argument("--output", type=Path, default=Path("nights"))
    chosen = arguments.parse_args()
    night, ratios = None, {"phasing": [], "ncpa": []}
    for seed in range(1, chosen.seeds + 1):
        folder = chosen.output / f"oopao-{seed}"
        if not (folder / "scene.toml").exists():
            with contextlib.redirect_stdout(io.StringIO()):
                night = night or Night()
                night.run(seed, chosen.images, folder)
        found = report([chosen.program, "estimate", folder / "night.fits", "--scene", folder / "scene.toml", "--method", "full-phase",
                        "-o", folder / "est.fits"])
        off = report([chosen.program, "compare", folder / "est.fits", "--truth", folder / "truth.fits"])
        line = f"seed {seed}:"
        for what, values in ratios.items():
            residual, sigma = off[f"{what}_residual_nm"], found[f"{what}_sigma_nm"]
            values.append(residual / sigma)
            line += f" {what} {residual:.2f} nm (error bar {sigma:.2f}),"
        gain = found.get("telemetry_gain")
        print(line, f"chi2 {found['reduced_chi2']:.2f}, gain of the slopes {gain:.3f}", *found["warnings"], flush=True)
    for what, values in ratios.items():
        print(f"{what}: residual over error bar {math.sqrt(np.mean(np.square(values))):.2f}")


if __name__ == "__main__":
    main()
