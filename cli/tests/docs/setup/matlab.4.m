% Frames of both channels.
scene = cophase.preset('keck-artificial');
plus_e = image_e(cophase.Model(cophase.scene_set(scene, 'image.diversity_focus_waves_rms', 0.7)));
minus_e = image_e(cophase.Model(cophase.scene_set(scene, 'image.diversity_focus_waves_rms', -0.7)));
