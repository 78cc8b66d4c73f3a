frames = image_e(cophase.Model(cophase.preset("keck-artificial")))[None]
