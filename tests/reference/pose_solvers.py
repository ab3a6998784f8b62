#!/usr/bin/env python3
"""Random minimal problems and the solutions of the reference solvers (numpy), for tests/native/pose/oracle.rs.

    python3 tests/reference/pose_solvers.py ../shared/bench/pose_reference.py > tests/goldens/pose_solvers.json
    python3 tests/reference/pose_solvers.py ../shared/bench/pose_reference.py --count 10000 --seed 1 > all.json

The first command makes the golden of the repository; the test reads another file where LANDLINE_POSE_SOLVERS names one.
Inputs are rounded to few digits and bearings, normals and directions normalised by the reader, here and there; the solutions
belong to the rounded inputs. A problem is kept when the reference's solutions satisfy it to 1e-9, contain the truth of the
unrounded problem within 1 %, and lie apart from each other: at a double root rounding decides how many there are.
Solutions: quaternion w, x, y, z, translation (pnplf: and the focal length in pixels).
"""
import argparse
import importlib.util
import json
import sys

import numpy as np

SOLVERS = ("p3p", "p2p1ll", "p1p2ll", "p3ll", "up2p", "up1p1ll", "pnplf")


def load(path):
    spec = importlib.util.spec_from_file_location("pose_reference", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def quaternion(R):
    # The largest component first, so that nothing is divided by a small number.
    m = np.array([1 + R[0, 0] + R[1, 1] + R[2, 2], 1 + R[0, 0] - R[1, 1] - R[2, 2],
                  1 - R[0, 0] + R[1, 1] - R[2, 2], 1 - R[0, 0] - R[1, 1] + R[2, 2]])
    i = int(np.argmax(m))
    s = 2 * np.sqrt(m[i])
    w, x, y = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    a, b, c = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    q = {0: [s * s / 4, w, x, y], 1: [w, s * s / 4, a, b], 2: [x, a, s * s / 4, c], 3: [y, b, c, s * s / 4]}[i]
    q = np.array(q) / s
    return q if q[0] >= 0 else -q


def violation(S, b, X, N, C, V):
    """Largest angle by which a pose misses bearings and viewing planes."""
    R, t = S[0], S[1]
    worst = 0.0
    if len(X):
        worst = np.abs(unit(X @ R.T + t) - b).max()
    if len(C):
        Z = C @ R.T + t
        worst = max(worst, np.abs((N * unit(Z)).sum(1)).max(), np.abs((N * (V @ R.T)).sum(1)).max())
    return worst


def apart(S):
    d = [np.abs(S[i][0] - S[j][0]).max() + np.linalg.norm(S[i][1] - S[j][1]) for i in range(len(S)) for j in range(i)]
    return min(d, default=np.inf) > 0.02


def calibrated(ref, name, rng):
    up = name[0] == "u"
    num_points, num_lines = {"p3p": (3, 0), "p2p1ll": (2, 1), "p1p2ll": (1, 2), "p3ll": (0, 3), "up2p": (2, 0), "up1p1ll": (1, 1)}[name]
    R, t, b, X, N, C, V = ref._instance(rng, up)
    b, X, N, C, V = (np.round(v, 5) for v in (b, X, N, C, V))
    raw = dict(bearings=b[:num_points], points=X[:num_points], normals=N[:num_lines], line_points=C[:num_lines], directions=V[:num_lines])
    b, N, V = unit(b), unit(N), unit(V)
    call = {
        "p3p": lambda: ref.p3p(b, X), "p2p1ll": lambda: ref.p2p1ll(b[:2], X[:2], N[0], C[0], V[0]),
        "p1p2ll": lambda: ref.p1p2ll(b[0], X[0], N[:2], C[:2], V[:2]), "p3ll": lambda: ref.p3ll(N, C, V),
        "up2p": lambda: ref.up2p(b[:2], X[:2]), "up1p1ll": lambda: ref.up1p1ll(b[0], X[0], N[0], C[0], V[0]),
    }[name]
    S = call()
    given = (b[:num_points], X[:num_points], N[:num_lines], C[:num_lines], V[:num_lines])
    good = all(violation(s, *given) < 1e-9 for s in S) and apart(S)
    near = min((np.abs(s[0] - R).max() + np.linalg.norm(s[1] - t) for s in S), default=np.inf) < 0.01 * (1 + np.linalg.norm(t))
    return raw, [list(quaternion(s[0])) + list(s[1]) for s in S], good and near


def with_focal(ref, rng):
    num_points = int(rng.integers(5))
    num_lines = 4 - num_points
    R, t, f = ref.random_rotation(rng), rng.normal(size=3), rng.uniform(400, 1500)
    Z = np.c_[rng.uniform(-.6, .6, (12, 2)), np.ones(12)] * rng.uniform(1, 8, (12, 1))
    X, u = (Z - t) @ R, Z[:, :2] / Z[:, 2:] * f
    p, XP = u[:num_points], X[:num_points]
    a, e = u[4:4 + num_lines], u[8:8 + num_lines]
    L = unit(np.cross(np.c_[a, np.ones(num_lines)], np.c_[e, np.ones(num_lines)])) if num_lines else np.zeros((0, 3))
    A = X[4:4 + num_lines]
    V = X[8:8 + num_lines] - A
    p, XP, A, V = (np.round(v, 5) for v in (p, XP, A, V))
    L = np.round(L, 8)
    raw = dict(pixels=p, points=XP, image_lines=L, line_points=A, directions=unit(V) if num_lines else V)
    raw["directions"] = np.round(raw["directions"], 6)
    V = unit(raw["directions"]) if num_lines else V
    S = [s for s in ref.pnplf(p, XP, L, A, V) if np.isfinite(s[2] + s[3]) and abs(np.log(s[2] / s[3])) < 0.1]
    if num_lines + num_points != 4 or not S:
        return raw, [], False
    focal = [np.sqrt(s[2] * s[3]) for s in S]
    near = min(abs(g / f - 1) + np.abs(s[0] - R).max() for s, g in zip(S, focal)) < 0.02
    # Near the limits of the aspect ratio the two implementations may disagree on what they drop.
    clear = all(abs(np.log(s[2] / s[3])) < 0.05 for s in S)
    return raw, [list(quaternion(s[0])) + list(s[1]) + [g] for s, g in zip(S, focal)], near and clear and apart(S)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference", help="pose_reference.py")
    parser.add_argument("--count", type=int, default=12, help="problems of each solver")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    ref = load(args.reference)
    out = {}
    for name in SOLVERS:
        rng = np.random.default_rng(args.seed)
        problems, tried = [], 0
        with np.errstate(all="ignore"):
            while len(problems) < args.count:
                tried += 1
                try:
                    raw, S, keep = with_focal(ref, rng) if name == "pnplf" else calibrated(ref, name, rng)
                except np.linalg.LinAlgError:
                    continue
                if keep:
                    problem = {k: np.asarray(v).tolist() for k, v in raw.items()}
                    problem["solutions"] = [[float(f"{v:.13g}") for v in s] for s in S]
                    problems.append(problem)
        out[name] = problems
        print(f"{name}: {args.count} of {tried} kept", file=sys.stderr)
    rows = (f' "{name}": [\n' + ",\n".join("  " + json.dumps(p, separators=(",", ":")) for p in problems) + "\n ]" for name, problems in out.items())
    print("{\n" + ",\n".join(rows) + "\n}")


if __name__ == "__main__":
    main()
