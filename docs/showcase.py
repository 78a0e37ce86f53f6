"""Generates the pictures of the documentation: python3 docs/showcase.py --data FOLDER --out docs

Needs the Python package Pillow and a built `headtail`. FOLDER contains envmaps/ and scenes/. --quick renders
few samples, to check the layout.
"""

import argparse
import pathlib
import shutil
import subprocess

from PIL import Image, ImageDraw, ImageFont

SCENES = {
    "temple": "sunset",
    "dishes": "window",
    "diorama": "studio",
    "droid": "window",
    "bedroom": "overcast",
    "arcade": "sunset",
    "cloth": "studio",
}
# Map, azimuth and pitch of the photograph, object and its placement.
COMPOSITES = {
    "spot, lebombo": ("lebombo_1k.hdr", 160, -24, "spot.glb", ["--material", "lambert", "--size", "1.1", "--turn", "30"]),
    "shader ball, noon_grass": ("noon_grass_1k.hdr", 40, -26, "usd_shaderball.glb", ["--size", "1.0"]),
    "robots, spiaggia": ("spiaggia_di_mondello_1k.hdr", 120, -24, "terrarium_robots.glb", ["--size", "1.5"]),
}
LABEL = 34


def montage(tiles, columns, path):
    """Joins pictures of one size on white, each above its label."""
    width, height = tiles[0][1].size
    rows = -(-len(tiles) // columns)
    sheet = Image.new("RGB", (columns * width, rows * (height + LABEL)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=20)
    for index, (label, picture) in enumerate(tiles):
        left, top = index % columns * width, index // columns * (height + LABEL)
        sheet.paste(picture.convert("RGB"), (left, top))
        draw.text((left + 10, top + height + 5), label, fill="black", font=font)
    sheet.save(path, quality=90)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--headtail", default="target/release/headtail")
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("docs"))
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("out/showcase"))
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)

    def run(*arguments):
        subprocess.run([given.headtail, *map(str, arguments), "--force", "--quiet"], check=True)

    spp = 16 if given.quick else 384
    tiles = []
    for scene, env in SCENES.items():
        picture = given.work / f"{scene}.exr"
        view = ["--scene", scene, "--env", env, "--depth", 6, "--width", 640, "--height", 480]
        run("render", *view, "--sampler", "patches+vis", "--spp", spp, "--out", picture)
        tiles.append((f"{scene}, under {env}", Image.open(picture.with_suffix(".png"))))
    satin, picture = "neural:checkpoints/satin.safetensors,repeat=20", given.work / "satin.exr"
    view = ["--scene", "cloth", "--env", "studio", "--material", satin, "--width", 640, "--height", 480]
    run("render", *view, "--sampler", "patches", "--spp", spp, "--out", picture)
    tiles.append(("cloth of satin, a neural material, under studio", Image.open(picture.with_suffix(".png"))))
    montage(tiles, 2, given.out / "scenes.jpg")

    before, after = [], []
    for number, (label, (env, azimuth, pitch, scene, placed)) in enumerate(COMPOSITES.items()):
        env, photo = given.data / "envmaps" / env, given.work / f"photo-{number}.exr"
        run("view", "--env", env, "--azimuth", azimuth, "--pitch", pitch, "--width", 720, "--height", 480, "--out", photo)
        folder = given.work / f"composite-{number}"
        camera = ["--photo", photo, "--camera", photo.with_suffix(".fspy")]
        samples = ["--spp", 8 if given.quick else 192]
        run("composite", *camera, "--env", env, "--scene", given.data / "scenes" / scene, *placed, *samples, "--out", folder)
        before.append((label, Image.open(photo.with_suffix(".png"))))
        after.append((f"{label}: composite", Image.open(folder / "composite.png")))
    montage([tile for pair in zip(before, after) for tile in pair], 2, given.out / "composites.jpg")

    # A scene and a map that no setting was chosen by, and the default training.
    env, scene = given.data / "envmaps" / "forest_slope_1k.hdr", given.data / "scenes" / "flight_helmet" / "FlightHelmet.gltf"
    view = ["--env", env, "--material", "ggx:alpha=0.3"]
    run("fit", *view, "--out", given.work / "head")
    samplers = f"split:4:mis-comp,mis-comp,head+mis:{given.work}/head/sampler.safetensors,auto"
    size = ["--width", 480, "--height", 360, "--seconds", 0.1 if given.quick else 1, "--runs", 3]
    run("compare", *view, "--scene", scene, "--ground", "--samplers", samplers, *size, "--out", given.work / "compare")
    shutil.copy(given.work / "compare" / "figures" / "pictures.svg", given.out / "equal-time.svg")


if __name__ == "__main__":
    main()
