"""Pictures that were altered or come from elsewhere: how many are located, how far off, and how many confident answers are wrong.

    cargo xtask rooms                 # makes the scenes
    python3 benches/altered_pictures.py --tool target/release/landline --scenes target/rooms --data ../shared/data

Every fourth test picture of each room as it is, and every eighth one zoomed (the middle, enlarged by a quarter), squeezed (to three
quarters of its height), cropped (an eighth of the top and a quarter of the left are missing), mirrored and turned by 90 degrees.
The intrinsics of the whole picture are passed with what keeps its size; the others come without any. Each scene also gets the
plain pictures of the other rooms. With `--all`: every test picture as it is, every second one altered, and every second of all
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


def rooms(data):
    """Per room: test pictures, positions of the camera by name, intrinsics."""
    kitchen = data / "redkitchen"
    positions = {pathlib.Path(c[0]).name: center(c[1:8]) for c in rows(kitchen / "poses_sfm.txt")}
    pictures = sorted((kitchen / "rgb").iterdir())[800:900]
    focal = rows(kitchen / "poses_sfm.txt")[0][8]
    yield "redkitchen", pictures, positions, f"SIMPLE_PINHOLE,640,480,{focal},320,240"
    corridor = data / "corridor"
    model = corridor / "sparse" / "0"
    positions = {c[9]: center(c[1:8]) for c in rows(model / "images.txt") if len(c) == 10}
    pictures = [corridor / "images" / c[0] for c in rows(corridor / "test8.txt")]
    yield "corridor", pictures, positions, ",".join(rows(model / "cameras.txt")[0][1:])
    hololens = data / "hololens"
    poses = [c for c in rows(hololens / "poses.txt") if len(c) >= 17]
    positions = {pathlib.Path(c[0]).name: np.array([float(c[i]) for i in (4, 8, 12)]) for c in poses}
    camera = "PINHOLE,540,360,495.56775700934577,495.4819626168224,269.50289719626164,169.1941121495327"
    yield "hololens", sorted((hololens / "rgb").iterdir())[100:160], positions, camera


def altered(picture, kind):
    image = Image.open(picture).convert("RGB")
    w, h = image.size
    if kind == "zoomed":
        cw, ch = round(w / 1.25), round(h / 1.25)
        x, y = (w - cw) // 2, (h - ch) // 2
        return image.crop((x, y, x + cw, y + ch)).resize((w, h), Image.LANCZOS)
    if kind == "squeezed":
        return image.resize((w, round(0.75 * h)), Image.LANCZOS)
    if kind == "cropped":
        return image.crop((w // 4, h // 8, w, h))
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
    parser.add_argument("--all", action="store_true", help="more of them: half an hour")
    args = parser.parse_args()
    step = 1 if args.all else 4
    known = list(rooms(args.data))
    print("| scene | pictures | number | located | confident | confident and wrong | median cm |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    answers = []
    with tempfile.TemporaryDirectory() as folder:
        for room, pictures, positions, camera in known:
            scene = args.scenes / f"{room}.landline"
            few = pictures[::step] if len(pictures) > 30 else pictures
            kinds = [("as they are", few, camera, True)]
            kinds.append(("without intrinsics", few, None, True))
            for kind in ("zoomed", "squeezed", "cropped", "mirrored", "turned"):
                made = pathlib.Path(folder) / room / kind
                made.mkdir(parents=True)
                for picture in few[::2]:
                    altered(picture, kind).save(made / picture.name, quality=95)
                own = camera if kind in ("zoomed", "mirrored") else None
                kinds.append((kind, sorted(made.iterdir()), own, kind not in ("mirrored", "turned")))
            for other, foreign, _, intrinsics in known:
                if other != room:
                    shown = sorted(foreign[0].parent.iterdir())[::2] if args.all else foreign[::4]
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
