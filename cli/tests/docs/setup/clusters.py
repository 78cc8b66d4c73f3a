# Frames, and a client that maps in this process: tests/c_api/nights.py maps over workers of Dask.
frames = [image_e(cophase.Model(cophase.preset("keck-artificial")), seed) for seed in (1, 2)]


class client:
    map = staticmethod(lambda function, items: [function(item) for item in items])
    gather = staticmethod(list)
