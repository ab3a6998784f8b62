#!/usr/bin/env python3
"""Times training steps of the `paper` preset in `landline train` and in PyTorch, on the same labels, one after the other.

    landline labels DATA --train 0-99 --extractor xfeat.safetensors --out labels.safetensors
    python3 benches/train_peer.py target/release/landline labels.safetensors xfeat.safetensors [--steps 20] [--threads 2]

Needs torch (CPU), numpy, safetensors. Both sides do the same: one picture a step, --points descriptors of 64 numbers and
--segments rows of 12 tokens, an input layer to width 256, the network and the losses of the paper (distances summed,
cross-entropy and clamped reprojection averaged), Adam. Ours is timed by its own log, between step 10 and the last.
"""
import argparse, json, os, subprocess, tempfile, time
import numpy as np
import torch
import torch.nn.functional as F
from safetensors import safe_open
from torch import nn

WIDTH, HEADS, TOKENS = 256, 4, 12


def mlp(*widths):
    layers = []
    for i, o in zip(widths, widths[1:]):
        layers += [nn.Linear(i, o), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def heads(x):
    return x.reshape(*x.shape[:-1], HEADS, WIDTH // HEADS).transpose(-2, -3)


def joined(x):
    return x.transpose(-2, -3).flatten(-2)


class Attend(nn.Module):
    def __init__(self):
        super().__init__()
        self.q, self.k, self.v, self.o = (nn.Linear(WIDTH, WIDTH) for _ in range(4))
        self.ffn = mlp(2 * WIDTH, 2 * WIDTH, WIDTH)

    def forward(self, x, mask):
        a = F.scaled_dot_product_attention(heads(self.q(x)), heads(self.k(x)), heads(self.v(x)), mask)
        return x + self.ffn(torch.cat([x, self.o(joined(a))], -1))


class Points(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.input = nn.Linear(d, WIDTH)
        self.prune = mlp(WIDTH, 256, 1)
        self.layers = nn.ModuleList(Attend() for _ in range(5))
        self.head = mlp(WIDTH, 512, 1024, 1024, 512, 3)

    def forward(self, x, attended):
        x = self.input(x)
        logits = self.prune(x)
        mask = torch.where(attended.T > 0, 0.0, float("-inf")).expand(x.shape[0], -1)
        for layer in self.layers:
            x = layer(x, mask)
        return self.head(x), logits


class Lines(nn.Module):
    def __init__(self, d):
        super().__init__()
        self.input = nn.Linear(d, WIDTH)
        self.q, self.k, self.v, self.o = (nn.Linear(WIDTH, WIDTH) for _ in range(4))
        self.ln1, self.ln2 = nn.LayerNorm(WIDTH, eps=1e-6), nn.LayerNorm(WIDTH, eps=1e-6)
        self.ff1, self.ff2 = nn.Linear(WIDTH, 1024), nn.Linear(1024, WIDTH)
        self.layer = Attend()
        self.prune = mlp(WIDTH, 256, 1)
        self.head = mlp(WIDTH, 512, 1024, 512, 6)

    def forward(self, x, attended):
        # Only the first token's output is used, so only the first token asks; the same exact shortcut as ours.
        x = self.input(x)
        first = x[:, :1]
        a = F.scaled_dot_product_attention(heads(self.q(first)), heads(self.k(x)), heads(self.v(x)), dropout_p=0.1)
        y = self.ln1(first + F.dropout(self.o(joined(a)), 0.1))
        y = self.ln2(y + F.dropout(self.ff2(F.gelu(self.ff1(y))), 0.1))[:, 0]
        y = self.layer(y, None)
        return self.head(y), self.prune(y)


def camera_space(p, rotation, translation):
    return p @ rotation.T + translation


def usable(z, error):
    return (z >= 0.1) & (z <= 1000.0) & (error <= 1000.0)


def clamped_mean(error, keep, t):
    limit = (1 - t * t) ** 0.5 * 50 + 1
    keep = keep.float()
    return (limit * torch.tanh(error / limit) * keep).sum() / keep.sum().clamp_min(1e-6)


def point_error(p, b):
    c = camera_space(p, b["rotation"], b["translation"])
    z = c[:, 2]
    uv = c[:, :2] / z.clamp_min(0.1)[:, None]
    error = ((uv - b["observed"]).square().sum(1) + 1e-12).sqrt() * b["focal"]
    return error, usable(z, error)


def line_error(p, b):
    error, ok = 0.0, True
    for end in (p[:, :3], p[:, 3:]):
        c = camera_space(end, b["rotation"], b["translation"])
        z = c[:, 2]
        uv1 = torch.cat([c[:, :2] / z.clamp_min(0.1)[:, None], torch.ones(len(c), 1)], 1)
        error = error + ((uv1 * b["observed"]).sum(1).square() + 1e-12).sqrt() * b["focal"]
        ok = ok & (z >= 0.1) & (z <= 1000.0)
    return error, ok & (error <= 1000.0)


def train(network, error_of, batches, steps, scale):
    adam = torch.optim.Adam(network.parameters(), lr=2e-4)
    network.train()
    begin = None
    for step in range(steps):
        if step == min(10, steps // 2):
            begin, first = time.perf_counter(), step
        b = batches[step % len(batches)]
        has = b["has_target"]
        coordinates, logits = network(b["inputs"], has)
        metres = coordinates * scale
        scene = (((metres - b["targets"]).square().sum(1) + 1e-12).sqrt() * has[:, 0]).sum()
        error, ok = error_of(metres, b)
        reprojection = clamped_mean(error, (has[:, 0] > 0) & ok, 0.5)
        loss = scene + reprojection + F.binary_cross_entropy_with_logits(logits, has)
        adam.zero_grad()
        loss.backward()
        adam.step()
        float(loss.detach())  # ours reads its losses back as well
    return (steps - first) / (time.perf_counter() - begin)


def batches(path, num_points, num_segments):
    """The first pictures as tensors: those with enough rows."""
    f = safe_open(path, "np")
    header = json.loads(f.metadata()["labels"])
    get = f.get_tensor
    descriptors, keypoints, point_targets = get("descriptors"), get("keypoints"), get("point_targets")
    tokens, segments, segment_targets = get("segment_descriptors"), get("segments"), get("segment_targets")
    points, lines = get("points")[:, :3], get("lines")[:, :6]
    centre = np.median(points, 0)
    out, n, m = ([], []), 0, 0
    for image in header["images"][:40]:
        r = np.array(image["rotation_row_major"]).reshape(3, 3)
        t = np.array(image["translation"]) + r @ centre
        p = image["camera"]["params"]
        fx, fy, cx, cy = (p[0], p[0], p[1], p[2]) if len(p) == 3 else p[:4]
        ray = lambda xy: (xy - np.array([cx, cy])) / np.array([fx, fy])
        common = {"rotation": r, "translation": t, "focal": np.array((fx + fy) / 2)}
        k = image["num_keypoints"]
        which = point_targets[n : n + k, 0]
        if k >= num_points:
            s = slice(n, n + num_points)
            has = which[:num_points] >= 0
            target = np.where(has[:, None], points[which[:num_points]] - centre, 0)
            out[0].append({**common, "inputs": descriptors[s], "observed": ray(keypoints[s, :2]),
                           "targets": target, "has_target": has[:, None]})
        l = image["num_segments"]
        which, back = segment_targets[m : m + l].T
        rows = np.arange(num_segments) % max(l, 1)
        has = which[rows] >= 0
        ends = lines[which[rows]].reshape(-1, 2, 3) - centre
        ends = np.where(back[rows, None, None] != 0, ends[:, ::-1], ends).reshape(-1, 6)
        a, b = (np.hstack([ray(segments[m + rows][:, c : c + 2]), np.ones((len(rows), 1))]) for c in (0, 2))
        line = np.cross(a, b)
        line /= np.hypot(line[:, 0], line[:, 1])[:, None]
        x = tokens.reshape(-1, TOKENS, tokens.shape[1])[m + rows]
        out[1].append({**common, "inputs": x, "observed": line, "targets": np.where(has[:, None], ends, 0),
                       "has_target": has[:, None]})
        n, m = n + k, m + l
    return [[{key: torch.tensor(np.asarray(v), dtype=torch.float32) for key, v in b.items()} for b in kind] for kind in out]


def ours(args):
    with tempfile.TemporaryDirectory() as folder:
        command = [args.landline, "train", args.labels, "--out", f"{folder}/x.landline", "--extractor", args.extractor,
                   "--preset", "paper", "--steps", str(args.steps), "--hold-out-every", "0", "--precision", "f16"]
        rates = []
        for kind, rows in (("keypoints", args.points), ("segments", args.segments)):
            run = f"{folder}/{kind}"
            extra = ["--set", f"rows={rows}", "--run", run] + (["--no-lines"] if kind == "keypoints" else [])
            subprocess.run(command + extra, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            log = [line.split(",") for line in open(f"{run}/log.csv")][1:]
            at = [(int(r[1]), float(r[8])) for r in log if r[0] == kind and int(r[1]) > 0]
            rates.append((at[-1][0] - at[0][0]) / (at[-1][1] - at[0][1]))
        return rates


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("landline")
    parser.add_argument("labels")
    parser.add_argument("extractor")
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--segments", type=int, default=256)
    parser.add_argument("--steps", type=int, default=30)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    os.environ["RAYON_NUM_THREADS"] = str(args.threads)
    point_batches, line_batches = batches(args.labels, args.points, args.segments)
    d = point_batches[0]["inputs"].shape[1]
    networks = (Points(d), Lines(d))
    print("parameters", [sum(p.numel() for p in n.parameters()) for n in networks], "torch", torch.__version__)
    theirs = [
        train(networks[0], point_error, point_batches, args.steps, 1.5),
        train(networks[1], line_error, line_batches, args.steps, 1.5),
    ]
    for name, rows, a, b in zip(("points", "lines"), (args.points, args.segments), ours(args), theirs):
        print(f"{name:7} {rows} rows: landline {a:.3f} steps/s, PyTorch {b:.3f} steps/s, ratio {a / b:.2f}")


if __name__ == "__main__":
    main()
