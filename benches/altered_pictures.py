"""Pictures that were altered or come from elsewhere: how many are located, how far off, and how many confident answers are wrong.

    cargo xtask rooms                 # makes the scenes
    python3 benches/altered_pictures.py --tool target/release/landline --scenes target/rooms --data ../shared/data

Every fourth test picture of each room as it is, and every eighth one zoomed (the middle, enlarged by a quarter), squeezed (to three
quarters of its height), cropped (an eighth of the top and a quarter of the left are missing), stretched
(the middle three quarters of its height, to the whole), narrow (0.8 times as wide, between black bars), mirrored and turned by 90
degrees.
The intrinsics of the whole picture are passed with what keeps its size; the others come without any. Then the same eighth with
intrinsics that are told rightly of a part, of a squeezed and of a bent picture (as a wide lens bends it), and wrongly: a squeezed
picture told as a part, principal points, focal lengths and distortions that are off. Each scene also gets the plain pictures of the other rooms. The rendered sample room of the
demo is one of them. With `--all`: every test picture as it is, every second one altered, and every second of all
pictures of the other rooms. Needs numpy and pillow.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile

import numpy as np
from PIL import Image, ImageOps

WRONG_M = 0.25
CONFIDENT = 0.9


def rotation(wxyz):
    w, x, y, z = np.asarray(wxyz) / np.linalg.norm(wxyz)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def rows(path):
    lines = pathlib.Path(path).read_text().splitlines()
    return [line.split() for line in lines if line.strip() and not line.startswith("#")]


def center(numbers):
    q = [float(v) for v in numbers[:4]]
    return -rotation(q).T @ np.array([float(v) for v in numbers[4:7]])


def rooms(data, sample):
    """Per room: scene where it is not that of its name, test pictures, positions of the camera by name, intrinsics."""
    scene = json.loads((sample / "sample.json").read_text())
    pictures = sorted(sample.glob("query-*.jpg"))
    poses = [np.array(p["cam_from_world"]) for p in scene["pictures"]]
    positions = {p.name: -m[:, :3].T @ m[:, 3] for p, m in zip(pictures, poses, strict=True)}
    c = scene["camera"]
    camera = "PINHOLE,{width},{height},{fx},{fy},{cx},{cy}".format(**c)
    yield "sample", sample / "sample.landline", pictures, positions, camera
    kitchen = data / "redkitchen"
    positions = {pathlib.Path(c[0]).name: center(c[1:8]) for c in rows(kitchen / "poses_sfm.txt")}
    pictures = sorted((kitchen / "rgb").iterdir())[800:900]
    focal = rows(kitchen / "poses_sfm.txt")[0][8]
    yield "redkitchen", None, pictures, positions, f"SIMPLE_PINHOLE,640,480,{focal},320,240"
    corridor = data / "corridor"
    model = corridor / "sparse" / "0"
    positions = {c[9]: center(c[1:8]) for c in rows(model / "images.txt") if len(c) == 10}
    pictures = [corridor / "images" / c[0] for c in rows(corridor / "test8.txt")]
    yield "corridor", None, pictures, positions, ",".join(rows(model / "cameras.txt")[0][1:])
    hololens = data / "hololens"
    poses = [c for c in rows(hololens / "poses.txt") if len(c) >= 17]
    positions = {pathlib.Path(c[0]).name: np.array([float(c[i]) for i in (4, 8, 12)]) for c in poses}
    camera = "PINHOLE,540,360,495.56775700934577,495.4819626168224,269.50289719626164,169.1941121495327"
    yield "hololens", None, sorted((hololens / "rgb").iterdir())[100:160], positions, camera


# Of a bent picture: its radial term.
BEND = -0.2


def numbers_of(camera):
    """fx, fy, cx, cy and the radial term."""
    model, _, _, *numbers = camera.split(",")
    n = [float(v) for v in numbers]
    if model.startswith("SIMPLE"):
        n.insert(1, n[0])
    return [*n[:4], n[4] if model == "SIMPLE_RADIAL" else 0.0]


def opencv(camera, width, height, fx=1.0, fy=1.0, cx=0.0, cy=0.0, bend=None, model="OPENCV"):
    """The camera for a size, its focal lengths multiplied and its principal point moved."""
    n = numbers_of(camera)
    k = n[4] if bend is None else bend
    values = (fx * n[0], fy * n[1], n[2] + cx, n[3] + cy, k, 0, 0, 0)
    return ",".join(str(v) for v in (model, width, height, *values))


def bent(image, camera):
    """The picture as a lens with another radial term shows it."""
    fx, fy, cx, cy, own = numbers_of(camera)
    w, h = image.size
    x, y = np.meshgrid((np.arange(w) + 0.5 - cx) / fx, (np.arange(h) + 0.5 - cy) / fy)
    u, v = x.copy(), y.copy()
    for _ in range(30):
        scale = 1 + BEND * (u * u + v * v)
        u, v = x / scale, y / scale
    scale = 1 + own * (u * u + v * v)
    at_x = np.clip(fx * u * scale + cx - 0.5, 0, w - 1.001)
    at_y = np.clip(fy * v * scale + cy - 0.5, 0, h - 1.001)
    left, top = at_x.astype(int), at_y.astype(int)
    a, b = (at_x - left)[..., None], (at_y - top)[..., None]
    p = np.asarray(image, dtype=float)
    upper = (1 - a) * p[top, left] + a * p[top, left + 1]
    lower = (1 - a) * p[top + 1, left] + a * p[top + 1, left + 1]
    return Image.fromarray(((1 - b) * upper + b * lower).round().astype(np.uint8))


def told(camera):
    """Altered pictures with the intrinsics that somebody tells of them: name, kind of picture, camera."""
    _, w, h, *_ = camera.split(",")
    w, h = int(w), int(h)
    low = round(0.75 * h)
    yield "part, told", "part", opencv(camera, w, low, cy=-(h - low) // 2)
    yield "cropped, told", "cropped", opencv(camera, w - w // 4, h - h // 8, cx=-(w // 4), cy=-(h // 8))
    yield "squeezed, told", "squeezed", opencv(camera, w, low, fy=low / h, cy=(low / h - 1) * h / 2)
    yield "squeezed, told as a part", "squeezed", opencv(camera, w, low, cy=(low - h) / 2)
    yield "principal point a quarter off", "same", opencv(camera, w, h, cx=-0.25 * w)
    yield "principal point in the corner", "same", opencv(camera, w, h, cx=-w / 2, cy=-h / 2)
    yield "focal length 1.22 times", "same", opencv(camera, w, h, fx=1.22, fy=1.22)
    yield "focal length 0.8 times", "same", opencv(camera, w, h, fx=0.8, fy=0.8)
    yield "one focal length 1.2 times", "same", opencv(camera, w, h, fy=1.2)
    yield "bent, told", "bent", opencv(camera, w, h, bend=BEND)
    yield "a radial term of 0.5", "same", opencv(camera, w, h, bend=0.5)
    yield "a radial term of -0.2", "same", opencv(camera, w, h, bend=BEND)
    yield "a fisheye's model", "same", opencv(camera, w, h, bend=0, model="OPENCV_FISHEYE")


def altered(picture, kind, camera):
    image = Image.open(picture).convert("RGB")
    if kind == "bent":
        return bent(image, camera)
    w, h = image.size
    if kind == "zoomed":
        cw, ch = round(w / 1.25), round(h / 1.25)
        x, y = (w - cw) // 2, (h - ch) // 2
        return image.crop((x, y, x + cw, y + ch)).resize((w, h), Image.LANCZOS)
    if kind == "squeezed":
        return image.resize((w, round(0.75 * h)), Image.LANCZOS)
    if kind == "cropped":
        return image.crop((w // 4, h // 8, w, h))
    if kind == "stretched":
        low = round(0.75 * h)
        return image.crop((0, (h - low) // 2, w, (h - low) // 2 + low)).resize((w, h), Image.LANCZOS)
    if kind == "narrow":
        sides = round(0.8 * w)
        boxed = Image.new("RGB", (w, h))
        boxed.paste(image.resize((sides, h), Image.LANCZOS), ((w - sides) // 2, 0))
        return boxed
    if kind == "part":
        low = round(0.75 * h)
        return image.crop((0, (h - low) // 2, w, (h - low) // 2 + low))
    if kind == "same":
        return image
    if kind == "mirrored":
        return ImageOps.mirror(image)
    return image.transpose(Image.ROTATE_90)


def locate(tool, scene, pictures, camera):
    command = [*tool, "locate", str(scene), *map(str, pictures), "--json"]
    command += ["--camera", camera] if camera else []
    out = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False).stdout
    return [json.loads(line) for line in out.splitlines()]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tool", required=True, help="the landline program")
    parser.add_argument("--scenes", required=True, type=pathlib.Path, help="folder with ROOM.landline")
    parser.add_argument("--data", required=True, type=pathlib.Path, help="folder of the rooms")
    parser.add_argument("--sample", default="www/scenes/sample", type=pathlib.Path, help="folder of the sample room")
    parser.add_argument("--all", action="store_true", help="more of them: half an hour")
    args = parser.parse_args()
    step = 1 if args.all else 4
    known = list(rooms(args.data, args.sample))
    print("| scene | pictures | number | located | confident | confident and wrong | median cm |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    answers = []
    with tempfile.TemporaryDirectory() as folder:
        for room, own_scene, pictures, positions, camera in known:
            scene = own_scene or args.scenes / f"{room}.landline"
            few = pictures[::step] if len(pictures) > 30 else pictures
            kinds = [("as they are", few, camera, True)]
            kinds.append(("without intrinsics", few, None, True))
            made = {}
            for kind in ("zoomed", "squeezed", "cropped", "stretched", "narrow", "mirrored", "turned", "part", "bent", "same"):
                at = pathlib.Path(folder) / room / kind
                at.mkdir(parents=True)
                for picture in few[::2]:
                    altered(picture, kind, camera).save(at / picture.name, quality=95)
                made[kind] = sorted(at.iterdir())
            for kind in ("zoomed", "squeezed", "cropped", "stretched", "narrow", "mirrored", "turned"):
                own = camera if kind in ("zoomed", "stretched", "narrow", "mirrored") else None
                kinds.append((kind, made[kind], own, kind not in ("mirrored", "turned")))
            kinds += [(name, made[kind], intrinsics, True) for name, kind, intrinsics in told(camera)]
            for other, _, foreign, _, intrinsics in known:
                if other != room:
                    every = sorted(p for p in foreign[0].parent.iterdir() if p.suffix in (".jpg", ".png"))
                    shown = every[::2] if args.all else foreign[::4]
                    kinds.append((f"of {other}", shown, intrinsics, False))
            for kind, chosen, intrinsics, is_here in kinds:
                found = locate([args.tool], scene, chosen, intrinsics)
                errors, confident, wrong = [], 0, 0
                for answer in found:
                    if not answer["pose"]:
                        continue
                    name = pathlib.Path(answer["picture"]).name
                    at = np.array(answer["pose"]["position"])
                    off = float(np.linalg.norm(at - positions[name])) if is_here else np.inf
                    sure = answer["quality"]["confidence"]
                    errors.append(off)
                    confident += sure > CONFIDENT
                    wrong += sure > CONFIDENT and off > WRONG_M
                    answers.append((sure, off <= WRONG_M))
                median = f"{100 * np.median(errors):.2f}" if errors and is_here else "-"
                print(f"| {room} | {kind} | {len(found)} | {len(errors)} | {confident} | {wrong} | {median} |", flush=True)
    sure, right = np.array([a for a, _ in answers]), np.array([float(b) for _, b in answers])
    off = 0.0
    for low, high in ((0, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.01)):
        inside = (sure >= low) & (sure < high)
        off += abs(sure[inside].sum() - right[inside].sum())
    print(f"calibration error of the confidence over {len(answers)} answers: {off / len(answers):.3f}")


if __name__ == "__main__":
    main()
