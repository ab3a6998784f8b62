#!/usr/bin/env python3
"""Times `landline lines` and other LSD implementations on the same photographs in one run, one thread each.

    cargo build --release -p landline-mapper --no-default-features
    python3 benches/lsd_peers.py target/release/landline FOLDER [--n 20] [--reps 7] [--wasm PACKAGE] [--segments OUT]

Needs numpy, opencv-python, and the peers that are to be timed: pytlsd, lsdetect (missing ones are left out).
For every picture the detectors take turns; each time is the least processor time over --reps, the table has the median
over the pictures. --wasm names target/web/bench (`cargo xtask web --bench`): Node then runs its `detectSegments` on the same pictures in the same
turns. --segments writes our segments with integer pixel centres, one line `frame x1 y1 x2 y2`, for agreement tables.
"""
import argparse, glob, json, os, subprocess, tempfile, time
for name in ("OMP_NUM_THREADS", "RAYON_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"
import cv2
import numpy as np

cv2.setNumThreads(1)


def peers():
    found = {}
    try:
        import pytlsd
        found["pytlsd"] = lambda u8, f64: pytlsd.lsd(f64)
    except ImportError:
        pass
    adv = cv2.createLineSegmentDetector(cv2.LSD_REFINE_ADV, scale=0.8)
    found[f"OpenCV {cv2.__version__} ADV"] = lambda u8, f64: adv.detect(u8)
    try:
        import lsdetect
        found["lsdetect"] = lambda u8, f64: lsdetect.detect(u8, 0.8)
    except ImportError:
        pass
    return found


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("landline")
    parser.add_argument("folder")
    parser.add_argument("--n", type=int, default=20)
    parser.add_argument("--reps", type=int, default=7)
    parser.add_argument("--glob", default="*.color.jpg")
    parser.add_argument("--wasm")
    parser.add_argument("--segments")
    args = parser.parse_args()
    files = sorted(glob.glob(os.path.join(args.folder, args.glob)))
    if not files:
        raise SystemExit(f"no {args.glob} in {args.folder}")
    files = [files[i] for i in np.linspace(0, len(files) - 1, min(args.n, len(files))).astype(int)]
    others = peers()
    times = {name: [] for name in ["landline", *(["landline, wasm in Node"] if args.wasm else []), *others]}
    rows, num_segments = [], []
    with tempfile.TemporaryDirectory() as folder:
        for frame, file in enumerate(files):
            u8 = cv2.imread(file, cv2.IMREAD_GRAYSCALE)
            f64 = u8.astype(np.float64)
            # The same grey levels for all: decoders and luma formulas differ.
            png = os.path.join(folder, "frame.png")
            cv2.imwrite(png, u8)
            raw = os.path.join(folder, "frame.raw")
            u8.tofile(raw)
            best = dict.fromkeys(times, np.inf)
            for _ in range(args.reps):
                out = subprocess.run([args.landline, "lines", png, "--json", "--repeat", "3"],
                                     check=True, capture_output=True, text=True).stdout
                ours = json.loads(out)
                best["landline"] = min(best["landline"], ours["min_ms"])
                for name, run in others.items():
                    start = time.process_time()
                    run(u8, f64)
                    best[name] = min(best[name], 1e3 * (time.process_time() - start))
            if args.wasm:
                script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "lsd_node.mjs")
                command = ["node", script, args.wasm, raw, str(u8.shape[1]), str(u8.shape[0]), str(10 * args.reps)]
                out = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                best["landline, wasm in Node"] = out["min_ms"]
                flat = [v for s in ours["segments"] for v in s]
                wasm = [v for i, v in enumerate(out["segments"]) if i % 7 != 5]
                if flat != wasm:
                    raise SystemExit(f"{file}: wasm differs from native")
            for name, value in best.items():
                times[name].append(value)
            num_segments.append(len(ours["segments"]))
            rows += [(frame, *(v - 0.5 for v in s[:4])) for s in ours["segments"]]
    median = {name: float(np.median(values)) for name, values in times.items()}
    height, width = u8.shape
    print(f"{len(files)} pictures {width}x{height}, {np.median(num_segments):.0f} segments (median), "
          f"least of {args.reps} turns, median over pictures\n")
    print("| detector | ms | relative to landline |\n|---|---:|---:|")
    for name, value in median.items():
        print(f"| {name} | {value:.2f} | {value / median['landline']:.2f} |")
    if args.segments:
        np.savetxt(args.segments, rows, fmt=["%d"] + ["%.17g"] * 4)


if __name__ == "__main__":
    main()
