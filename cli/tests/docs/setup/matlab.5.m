scene = cophase.preset('keck-onsky');
[frames, slopes_mas] = exposures(scene);
