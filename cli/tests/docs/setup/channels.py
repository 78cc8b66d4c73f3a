# Frames of both channels.
models = [cophase.Model(cophase.scene_set(cophase.preset("keck-artificial"), image__diversity_focus_waves_rms=focus)) for focus in (0.7, -0.7)]
plus_e, minus_e = (image_e(model) for model in models)
