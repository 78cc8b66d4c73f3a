# %% [markdown]
# # A folder of nights on a Dask cluster
#
# One estimate for each file of images in a folder, on the workers of a Dask cluster: here two processes of this
# machine; `Client("tcp://scheduler:8786")` takes those of a cluster. Runs as a script:
#
#     python dask_nights.py SCENE.toml FOLDER TABLE.csv [WORKERS]
#
# Files are NumPy's (`.npy`), or FITS where astropy is installed: (images, rows, cols), electrons. Needs `distributed`.

# %%
import csv
import sys
from pathlib import Path

import cophase
import numpy as np
from distributed import Client, LocalCluster

NUMBERS = ["images", "used", "phasing_rms_nm", "phasing_sigma_nm", "ncpa_rms_nm", "ncpa_sigma_nm"]
COLUMNS = ["night", *NUMBERS, "status", "why"]

# %% [markdown]
# ## What a worker does
#
# What a worker returns are numbers: an `Estimate` is memory of its process, and does not pickle.

# %%
def frames_of(path):
    if path.suffix == ".npy":
        return np.load(path)
    from astropy.io import fits

    return fits.getdata(path)


def night(path, estimator):
    """One row of the table; a night that cannot be used says why and stops no other."""
    row = {"night": path.name}
    try:
        estimate = estimator.estimate(frames_of(path))
        estimate.write(path.with_suffix(".estimate.fits"))
        numbers = {name: getattr(estimate.info, name) for name in NUMBERS}
        return {**row, **numbers, "status": estimate.info.status, "why": ""}
    except (cophase.Error, OSError, ValueError) as error:
        return {**row, "status": "failed", "why": str(error)}


# %% [markdown]
# ## The map
#
# An estimator pickles as its scene. It is sent once to each worker, which makes its own of it and keeps it. Results
# come in the order of the nights. A worker that dies is replaced, and its night is tried again.

# %%
def main(scene_file, folder, table, workers=2):
    scene_file, folder = Path(scene_file).resolve(), Path(folder).resolve()
    files = (path for path in folder.iterdir() if path.suffix in (".npy", ".fits"))
    nights = sorted(path for path in files if not path.name.endswith(".estimate.fits"))
    # A scene that is wrong ends here, and not on a worker.
    estimator = cophase.Estimator(scene_file, threads=1)
    # One thread to a worker: an estimator runs one call at a time.
    with LocalCluster(n_workers=int(workers), threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            sent = client.scatter(estimator, broadcast=True)
            rows = client.gather(client.map(night, nights, estimator=sent))
    with open(table, "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    return rows


# Workers import this file: only the script itself starts a cluster.
if __name__ == "__main__":
    for row in main(*sys.argv[1:]):
        print(*row.values())
