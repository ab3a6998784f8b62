"""What map_node.mjs or map_browser.mjs placed and found, beside poses that are known.

    python benches/map_check.py OUT.json POSES

POSES is a list of `NAME QW QX QY QZ TX TY TZ` (camera from world). A similarity from the placed pictures alone takes the
scene into the list's frame; then the placed and the located ones are compared. Prints centimetres where the list is in metres.
"""

import json
import sys

import numpy as np


def rotation(w, x, y, z):
    w, x, y, z = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def number(name):
    """Digits of a file name, so that `7` and `frame-000007.color.jpg` are the same picture."""
    return int("".join(c for c in name.rsplit("/", 1)[-1].split(".")[0] if c.isdigit()))


result, poses = sys.argv[1:3]
known = {}
for line in open(poses):
    parts = line.split()
    if len(parts) >= 8 and not line.startswith("#"):
        r, t = rotation(*map(float, parts[1:5])), np.array([float(v) for v in parts[5:8]])
        known[number(parts[0])] = (-r.T @ t, r)
result = json.load(open(result))


def both(rows):
    """Centres and rotations as found and as known, of the rows that have both."""
    out = []
    for row in rows:
        if row["pose"] is not None and number(row["name"]) in known:
            m = np.array(row["pose"], dtype=float).reshape(-1, 4)[:3]
            out.append((-m[:, :3].T @ m[:, 3], m[:, :3], *known[number(row["name"])]))
    return [np.array(column) for column in zip(*out)]


a, ra, b, rb = both(result["placed"])
ma, mb = a.mean(0), b.mean(0)
u, s, v = np.linalg.svd((b - mb).T @ (a - ma))
d = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
turn = u @ d @ v
scale = (s * np.diag(d)).sum() / ((a - ma) ** 2).sum()
shift = mb - scale * turn @ ma


def errors(columns):
    found, rf, truth, rt = columns
    away = 100 * np.linalg.norm(scale * found @ turn.T + shift - truth, axis=1)
    trace = np.einsum("nij,nij->n", rf @ turn.T, rt)
    return away, np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


away, angle = errors((a, ra, b, rb))
print(f"placed {len(a)} of {len(result['placed'])}: median {np.median(away):.2f} cm, {np.median(angle):.2f} deg, at most {away.max():.2f} cm")
n = len(result["found"])
columns = both(result["found"])
if not columns:
    sys.exit(f"none of {n} located")
away, angle = errors(columns)
within = lambda cm, deg: 100 * np.sum((away <= cm) & (angle <= deg)) / n
print(
    f"located {len(away)} of {n}: median {np.median(away):.2f} cm, {np.median(angle):.2f} deg, "
    f"{within(2, 2):.0f} % at 2/2, {within(5, 5):.0f} % at 5/5, at most {away.max():.2f} cm"
)
