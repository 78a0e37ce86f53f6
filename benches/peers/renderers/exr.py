"""Reads three channels of an OpenEXR file as an array [height, width, 3]."""

import numpy as np
import OpenEXR


def read(path, layer=None):
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        names = [layer] if layer else ["RGB", "RGBA"]
        for name in names:
            if name in channels:
                return np.array(channels[name].pixels[..., :3], np.float64)
        prefix = f"{layer}." if layer else ""
        return np.stack([np.array(channels[prefix + name].pixels, np.float64) for name in "RGB"], -1)
