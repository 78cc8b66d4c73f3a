% A scene file, and a frame as floats row by row.
scene_240 = cophase.scene_set(cophase.preset('keck-artificial'), 'image.pixels', 240, 'image.crop_pixels', 240);
file = fopen('scene.toml', 'w'); fputs(file, scene_240); fclose(file);
file = fopen('frame.f32', 'w'); fwrite(file, image_e(cophase.Model(scene_240))', 'single'); fclose(file);
