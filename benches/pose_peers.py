#!/usr/bin/env python3
"""Solves the same pose problems with Landline and with PoseLib in one run, one thread each, and prints a table.

    cargo build --release -p landline-mapper --no-default-features --example pose_problems
    python3 benches/pose_peers.py target/release/examples/pose_problems FOLDER [--settings a,b] [--wasm PACKAGE] [--budget 60] [--json OUT]

Needs numpy and poselib. FOLDER holds `.plb` files (format: testkit/src/problem_file.rs). Times are processor milliseconds of the
solving thread, the median over the problems; ours after one warm-up, the median of --repeat. PoseLib is called as PL2Map calls it
(`pnpl`: 12 and 10 px, everything else default) and in the other ways that a caller can choose; a method stops after --budget
seconds, and the table then says how many problems it has seen. --wasm names target/web/bench (`cargo xtask web --bench`): Node solves the same files.
Success: within 5 cm and 5 degrees. Gross failure: off by more than 25 cm or 5 degrees, or no pose.
"""
import argparse
import glob
import json
import os
import struct
import subprocess
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
import numpy as np
import poselib

ORDER = "easy typical noisy3d few many lowinl badpts lines coherent coherrel verylow".split()


def read(path):
    data = open(path, "rb").read()
    if data[:4] != b"PLB1":
        raise SystemExit(f"{path} is not a pose problem file")
    at, problems = 8, []

    def numbers(n):
        nonlocal at
        at += 8 * n
        return np.frombuffer(data, "<f8", n, at - 8 * n)

    for _ in range(struct.unpack_from("<I", data, 4)[0]):
        camera, R, t = numbers(6), numbers(9).reshape(3, 3), numbers(3)
        num_points, num_lines = struct.unpack_from("<II", data, at)
        at += 8
        points, lines = numbers(7 * num_points).reshape(-1, 7), numbers(12 * num_lines).reshape(-1, 12)
        problems.append(dict(camera=camera, R=R, t=t, points=points, lines=lines))
    return problems


def methods(tau_points, tau_lines):
    def camera(p):
        w, h, *params = p["camera"]
        return {"model": "PINHOLE", "width": int(w), "height": int(h), "params": list(params)}

    def pnpl(p, least=0.0, **options):
        a, b = (p[kind][p[kind][:, -2] >= least] for kind in ("points", "lines"))
        options |= dict(max_reproj_error=tau_points, max_epipolar_error=tau_lines)
        return poselib.estimate_absolute_pose_pnpl(
            a[:, :2], a[:, 2:5], b[:, :2], b[:, 2:4], b[:, 4:7], b[:, 7:10], camera(p), options, {})

    def pnp(p, **options):
        a = p["points"]
        if options.get("progressive_sampling"):
            a = a[np.argsort(-a[:, 5])]
        return poselib.estimate_absolute_pose(a[:, :2], a[:, 2:5], camera(p), dict(options, max_reproj_error=tau_points), {})

    return {
        "pnpl": pnpl,
        "min50": lambda p: pnpl(p, min_iterations=50),
        "cap5k": lambda p: pnpl(p, max_iterations=5000),
        "pruned": lambda p: pnpl(p, least=0.5),
        "pruned, min50": lambda p: pnpl(p, least=0.5, min_iterations=50),
        "pnp": pnp,
        "pnp, PROSAC": lambda p: pnp(p, progressive_sampling=True),
    }


def errors(p, R, t):
    """Degrees and centimetres."""
    if R is None or not (np.all(np.isfinite(R)) and np.all(np.isfinite(t))):
        return 180.0, np.inf
    cos = np.clip((np.trace(p["R"].T @ R) - 1) / 2, -1, 1)
    return np.degrees(np.arccos(cos)), 100 * np.linalg.norm(p["R"].T @ p["t"] - R.T @ t)


def summary(rows, total):
    degrees, cm, ms = (np.array(column, float) for column in zip(*rows))
    return dict(n=len(rows), total=total, ms=float(np.median(ms)), ms95=float(np.quantile(ms, 0.95)),
                success=float(np.mean((degrees < 5) & (cm < 5))), gross=float(np.mean((degrees > 5) | (cm > 25))),
                degrees=float(np.median(degrees)), cm=float(np.median(cm)))


def poselib_rows(problems, solve, budget):
    rows, start = [], time.perf_counter()
    solve(problems[0])
    for p in problems:
        begin = time.thread_time()
        pose, _ = solve(p)
        ms = 1e3 * (time.thread_time() - begin)
        rows.append((*errors(p, np.asarray(pose.R), np.asarray(pose.t)), ms))
        if time.perf_counter() - start > budget:
            break
    return rows


def our_rows(problems, command):
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows, poses = [], []
    for line in out.splitlines():
        j = json.loads(line)
        R = np.reshape(j["R"], (3, 3)) if j["R"] else None
        rows.append((*errors(problems[j["i"]], R, np.array(j["t"] or [0, 0, 0], float)), j["ms"]))
        poses.append((j["R"], j["t"], j["iters"]))
    return rows, poses


def table_row(name, result):
    ours, pnpl = result["landline"], result["pnpl"]
    total = ours["total"]
    peers = [m for m in result if m not in ("landline", "wasm")]
    # A rate over a handful of problems says nothing.
    peers = [m for m in peers if 2 * result[m]["n"] >= total] or peers
    best = max(peers, key=lambda m: (result[m]["success"], -result[m]["gross"], -result[m]["ms"]))
    seen = lambda r: "" if r["n"] == total else f" (n {r['n']})"
    three = (ours, pnpl, result[best])
    cells = [name, str(total)]
    cells += [f"{100 * r['success']:.1f}{seen(r)}" for r in three] + [f"{100 * r['gross']:.1f}" for r in three]
    cells += [f"{r['ms']:.2f}" for r in three] + [f"{ours['ms'] / pnpl['ms']:.3f}", best]
    if "wasm" in result:
        cells += [f"{result['wasm']['ms']:.2f}", f"{result['wasm']['ms'] / ours['ms']:.2f}"]
    return "| " + " | ".join(cells) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("landline")
    parser.add_argument("folder")
    parser.add_argument("--settings", help="names of files, without the ending")
    parser.add_argument("--tau", type=float, nargs=2, default=(12.0, 10.0), metavar=("POINTS", "LINES"))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--wasm")
    parser.add_argument("--json")
    args = parser.parse_args()
    names = [os.path.splitext(os.path.basename(f))[0] for f in glob.glob(os.path.join(args.folder, "*.plb"))]
    names = args.settings.split(",") if args.settings else sorted(names, key=lambda n: (ORDER + [n]).index(n))
    tau = [str(v) for v in args.tau]
    here = os.path.dirname(os.path.abspath(__file__))
    print(f"PoseLib {poselib.__version__}, {tau[0]} and {tau[1]} px; success and gross failures in percent, median milliseconds\n")
    columns = ["setting", "n", "success: landline", "pnpl", "best call", "gross: landline", "pnpl", "best call",
               "ms: landline", "pnpl", "best call", "landline / pnpl", "best call is"]
    if args.wasm:
        columns += ["wasm ms", "wasm / native"]
    print("| " + " | ".join(columns) + " |\n|---|" + "---:|" * (len(columns) - 1))
    results = {}
    for name in names:
        path = os.path.join(args.folder, name + ".plb")
        problems = read(path)
        if not problems:
            raise SystemExit(f"{path} holds no problem")
        rows, poses = our_rows(problems, [args.landline, path, *tau, "--repeat", str(args.repeat)])
        result = results[name] = dict(landline=summary(rows, len(problems)))
        for method, solve in methods(*args.tau).items():
            if method.startswith("pnp,") or method == "pnp":
                if not len(problems[0]["points"]):
                    continue
            result[method] = summary(poselib_rows(problems, solve, args.budget), len(problems))
        if args.wasm:
            command = ["node", os.path.join(here, "pose_node.mjs"), args.wasm, path, *tau, str(args.repeat)]
            rows, in_wasm = our_rows(problems, command)
            if in_wasm != poses:
                differ = [i for i, (a, b) in enumerate(zip(poses, in_wasm)) if a != b]
                raise SystemExit(f"{path}: wasm differs from native in problems {differ}")
            result["wasm"] = summary(rows, len(problems))
        print(table_row(name, result), flush=True)
    if args.json:
        json.dump(results, open(args.json, "w"), indent=1)


if __name__ == "__main__":
    main()
