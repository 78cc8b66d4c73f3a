"""
A checklist for real data
=========================

*How do I find out which key of my scene is wrong?*

A real image comes with a scene that may be wrong: a plate scale, a rotation, a flip, an uneven illumination. ``cophase check`` fits what
scene and image can contradict each other in, before the errors go into an estimate. This tutorial uses the program.
"""

# %%
# An image of a camera that differs from the scene: the plate scale is off by 0.8 %, and the pupil is turned by 0.6 degrees.

import json
import os
import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

program = os.environ.get("COPHASE_PROGRAM", "cophase")
folder = Path(tempfile.mkdtemp())
(folder / "scene.toml").write_text("""
[pupil]
aperture = "hexagonal"
rings = 1
spider_width_m = 0.1
samples = 120

[image]
wavelength_nm = 2000
samples_per_lambda_over_d = 2
pixels = 128
diversity_focus_waves_rms = 1.0
peak_snr = 300
read_noise_e = 20

[aberrations]
segment_piston_rms_nm = 60
ncpa_rms_nm = 50
ncpa_zernikes = [4, 11]
seed = 4

[modes]
ncpa = "zernike"
ncpa_count = 14
exact_zernikes = []
""")


def cophase(*words):
    """Runs the program in the folder, and returns what it prints."""
    done = subprocess.run([program, *words], cwd=folder, capture_output=True, text=True, check=False)
    print("$ cophase", *words)
    print(done.stderr, end="")
    assert done.returncode == 0, done.returncode
    return done.stdout


off = ["--set", "image.samples_per_lambda_over_d=2.016", "--set", "pupil.rotation_deg=0.6"]
print(cophase("image", "scene.toml", "-o", "images.fits", *off))

# %%
# Does the header contradict the scene?
# -------------------------------------
#
# An estimate is refused where the header of the file contradicts the scene (wavelength, plate scale, noise, the scene in a file of
# ``cophase``), and the message names both values. A header can be wrong, too: the image decides.

refused = subprocess.run(
    [program, "estimate", "images.fits", "--scene", "scene.toml", "-o", "est.fits"],
    cwd=folder, capture_output=True, text=True, check=False,
)  # fmt: skip
print(refused.stderr)
assert refused.returncode == 1

# %%
# Does the image contradict the scene?
# ------------------------------------
#
# ``cophase check`` lists which quantities agree, which are at fault, and which an image cannot determine. It names the likeliest cause
# and the key to set; other faults may be consequences of the first, so it is run again with the corrected scene until none is left.

scene = "scene.toml"
chi2 = []
for step in range(1, 4):
    found = json.loads(cophase("check", "images.fits", "--scene", scene, "--json", "--write", f"corrected-{step}.toml"))
    chi2.append(found["reduced_chi2"])
    faults = [one for one in found["findings"] if one["verdict"] == "fault" and one["found"] is not None]
    for one in faults:
        print(f"  {one['quantity']}: {one['found']:.5f} ± {one['sigma']:.5f}, the scene has {one['scene']:g}")
    print(f"  reduced χ² {found['reduced_chi2']:.2f}")
    if not faults:
        break
    scene = f"corrected-{step}.toml"

# %%
# Is the orientation known?
# -------------------------
#
# An image does not show whether it is flipped, nor the sign of the defocus: two images with a known poke of a segment between them do
# (``cophase check --before``).
#
# The estimate
# ------------

cophase("estimate", "images.fits", "--scene", scene, "--trust", "scene", "-o", "est.fits", "--plot", "est.png")
print(cophase("compare", "est.fits", "--truth", "images.fits"))

figure, axis = plt.subplots(figsize=(9, 9), layout="constrained")
axis.imshow(plt.imread(folder / "est.png"))
axis.set_axis_off()
plt.show()

figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
axis.semilogy(range(len(chi2)), chi2, "o-")
axis.axhline(1, color="grey", linewidth=0.8)
axis.set_xticks(range(len(chi2)), ["scene", *(f"corrected {step}" for step in range(1, len(chi2)))])
axis.set_ylabel("reduced χ²")
plt.show()

assert chi2[0] > 10 and chi2[-1] < 1.5, chi2
