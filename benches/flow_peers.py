"""The tracker's patches beside OpenCV's calcOpticalFlowPyrLK: same pictures, same points, same pyramid, window and levels.

    python benches/flow_peers.py FOLDER_OF_PICTURES [--tool target/release/landline] [--count 12]

Each picture is moved by a known shift, turn and scale (Lanczos interpolation), changed in brightness, and given sensor noise; the
true place of every point is known. Both search from the point's own position. One thread. Times are of the processor, so that
other jobs on the machine do not count; both build the pyramids of both pictures each time. Needs numpy and opencv.
"""

import argparse
import json
import pathlib
import resource
import subprocess
import tempfile
import time

import cv2
import numpy as np

WINDOW, MAX_LEVEL = 16, 3
# Shift in pixels, turn in degrees, scale, gain, offset.
CASES = {
    "shift below a pixel": ((0.4, -0.3), 0.0, 1.0, 1.0, 0.0),
    "shift of 7 pixels": ((6.3, -3.1), 0.0, 1.0, 1.0, 0.0),
    "shift of 20 pixels": ((17.2, 10.4), 0.0, 1.0, 1.0, 0.0),
    "turn of 3 degrees": ((2.0, 1.0), 3.0, 1.0, 1.0, 0.0),
    "3 % larger": ((1.0, -2.0), 0.0, 1.03, 1.0, 0.0),
    "darker by a third": ((3.3, 2.1), 0.0, 1.0, 0.67, 10.0),
}
NOISE = 2.0


def moved(image, shift, turn, scale):
    height, width = image.shape
    matrix = cv2.getRotationMatrix2D((width / 2 - 0.5, height / 2 - 0.5), turn, scale)
    matrix[:, 2] += shift
    return cv2.warpAffine(image, matrix, (width, height), flags=cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101), matrix


def noisy(image, rng, gain=1.0, offset=0.0):
    return np.clip(np.rint(gain * image + offset + rng.normal(0, NOISE, image.shape)), 0, 255).astype(np.uint8)


def opencv(first, second, points, repeat):
    times = []
    for _ in range(repeat):
        start = time.process_time()
        found, status, _ = cv2.calcOpticalFlowPyrLK(
            first, second, points, None, winSize=(WINDOW, WINDOW), maxLevel=MAX_LEVEL,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.01))
        forward = time.process_time() - start
        back, status_back, _ = cv2.calcOpticalFlowPyrLK(
            second, first, found, None, winSize=(WINDOW, WINDOW), maxLevel=MAX_LEVEL,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.01))
        times.append((1e3 * forward, 1e3 * (time.process_time() - start)))
    round_trip = np.linalg.norm(back - points, axis=1)
    good = (status[:, 0] == 1) & (status_back[:, 0] == 1)
    return found, np.where(good, round_trip, np.inf), np.median(times, axis=0)


def cpu_time(command, repeat):
    """What the tool says, and its processor time for one pair: that of many repetitions less that of a few."""
    spent = []
    for times in (1, 1 + 4 * repeat):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        said = subprocess.run([*command, "--repeat", str(times)], check=True, capture_output=True, text=True).stdout
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return json.loads(said), 1e3 * (spent[1] - spent[0]) / (4 * repeat)


def ours(tool, folder, first, second, points, repeat, kernels):
    paths = [str(folder / name) for name in ("first.png", "second.png", "points.txt")]
    cv2.imwrite(paths[0], first)
    cv2.imwrite(paths[1], second)
    # Corner-based pixels there, index coordinates in OpenCV.
    np.savetxt(paths[2], points + 0.5, fmt="%.6f")
    command = [tool, "flow", paths[0], paths[1], "--points", paths[2], "--kernels", kernels]
    both, both_ms = cpu_time(command, repeat)
    _, forward_ms = cpu_time([*command, "--no-way-back"], repeat)
    found = np.full(points.shape, np.nan)
    round_trip = np.full(len(points), np.inf)
    for i, flow in enumerate(both["points"]):
        if flow and flow[2] >= 0.75:
            found[i] = np.array(flow[:2]) - 0.5
            round_trip[i] = np.inf if flow[3] is None else flow[3]
    return found, round_trip, (forward_ms, both_ms), both["kernels"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("--tool", default="target/release/landline")
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--points", type=int, default=150)
    parser.add_argument("--repeat", type=int, default=15)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rng = np.random.default_rng(1)
    paths = sorted(p for p in args.pictures.iterdir() if p.suffix in (".jpg", ".png"))
    paths = paths[:: max(1, len(paths) // args.count)][: args.count]
    print(f"{len(paths)} pictures, {args.points} points each, window {WINDOW}, {MAX_LEVEL + 1} levels, noise {NOISE}; OpenCV {cv2.__version__}, one thread")
    print("error in pixels: median and 90 % over the points that both find; found: within 1 px of the truth")
    print("| | OpenCV error | found | ms, and with the way back | ours, error | found | ms, and with the way back | ours / OpenCV, with the way back |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for name, (shift, turn, scale, gain, offset) in CASES.items():
            rows = {"cv": ([], [], []), "ours": ([], [], [])}
            for path in paths:
                clean = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
                other, matrix = moved(clean, shift, turn, scale)
                first, second = noisy(clean, rng), noisy(other, rng, gain, offset)
                points = cv2.goodFeaturesToTrack(first[40:-40, 40:-40], args.points, 0.005, 8)[:, 0] + 40
                truth = points @ matrix[:, :2].T + matrix[:, 2]
                height, width = first.shape
                inside = np.all((truth > 20) & (truth < [width - 20, height - 20]), axis=1)
                points, truth = points[inside].astype(np.float32), truth[inside]
                results = {"cv": opencv(first, second, points, args.repeat)}
                *results["ours"], kernels = ours(args.tool, folder, first, second, points, args.repeat, "auto")
                errors = {who: np.linalg.norm(r[0] - truth, axis=1) for who, r in results.items()}
                accepted = {who: np.nan_to_num(errors[who], nan=np.inf) for who in results}
                for who in results:
                    accepted[who][~(results[who][1] < 0.7)] = np.inf
                common = (accepted["cv"] < 3) & (accepted["ours"] < 3)
                for who in results:
                    rows[who][0].append(errors[who][common])
                    rows[who][1].append(np.mean(accepted[who] < 1))
                    rows[who][2].append(results[who][2])
            cells = [name]
            for who in ("cv", "ours"):
                error = np.concatenate(rows[who][0])
                time_ms = np.median(rows[who][2], axis=0)
                cells += [f"{np.median(error):.3f}, {np.quantile(error, 0.9):.3f}", f"{100 * np.mean(rows[who][1]):.1f} %", f"{time_ms[0]:.2f}, {time_ms[1]:.2f}"]
            ratio = np.median(rows["ours"][2], axis=0) / np.median(rows["cv"][2], axis=0)
            cells.append(f"{ratio[0]:.2f}, {ratio[1]:.2f}")
            print("| " + " | ".join(cells) + " |", flush=True)
    print(f"ours with {kernels} kernels")


if __name__ == "__main__":
    main()
