"""Makes what the timings need, in a folder: random weights under the names of Landline's files, inputs, and the same
networks as ONNX for the other engines.

    python networks.py FOLDER

XFeat, SuperPoint and the branches are written here a second time, from their descriptions, in PyTorch; the timing scripts compare
the outputs of all engines before they time anything.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional as F


def conv(i, o, stride=1):
    return nn.Conv2d(i, o, 3, stride, 1)


def chain(layers, relu_last=True):
    parts = []
    for index, layer in enumerate(layers):
        parts.append(layer)
        if relu_last or index + 1 < len(layers):
            parts.append(nn.ReLU())
    return nn.Sequential(*parts)


class XFeat(nn.Module):
    """The dense part, batch norms folded; from a grey picture [1, 1, H, W] to features, keypoint logits, reliability."""

    def __init__(self):
        super().__init__()
        one = lambda i, o: nn.Conv2d(i, o, 1)
        self.skip = one(1, 24)
        self.block1 = chain([conv(1, 4), conv(4, 8, 2), conv(8, 8), conv(8, 24, 2)])
        self.block2 = chain([conv(24, 24), conv(24, 24)])
        self.block3 = chain([conv(24, 64, 2), conv(64, 64), one(64, 64)])
        self.block4 = chain([conv(64, 64, 2), conv(64, 64), conv(64, 64)])
        self.block5 = chain([conv(64, 128, 2), conv(128, 128), conv(128, 128), one(128, 64)])
        self.fusion = chain([conv(64, 64), conv(64, 64), one(64, 64)], relu_last=False)
        self.reliability = chain([one(64, 64), one(64, 64), one(64, 1)], relu_last=False)
        self.keypoint = chain([one(64, 64), one(64, 64), one(64, 64), one(64, 65)], relu_last=False)

    def forward(self, gray):
        mean = gray.mean((2, 3), keepdim=True)
        variance = (gray - mean).square().mean((2, 3), keepdim=True)
        x = (gray - mean) / torch.sqrt(variance + 1e-5)
        x1 = self.block1(x) + self.skip(F.avg_pool2d(x, 4))
        x3 = self.block3(self.block2(x1))
        x4 = self.block4(x3)
        x5 = self.block5(x4)
        size = x3.shape[-2:]
        up = lambda t: F.interpolate(t, size, mode="bilinear", align_corners=False)
        features = self.fusion(x3 + up(x4) + up(x5))
        cells = F.pixel_unshuffle(x, 8)
        logits = self.keypoint(cells)
        heat = F.pixel_shuffle(logits.softmax(1)[:, :64], 8)
        unit = features / features.square().sum(1, keepdim=True).sqrt().clamp_min(1e-12)
        return unit, heat, torch.sigmoid(self.reliability(features))

    def named(self):
        out = {"skip.w": self.skip.weight[:, :, 0, 0], "skip.b": self.skip.bias}
        for name in ["block1", "block2", "block3", "block4", "block5", "fusion", "reliability", "keypoint"]:
            layers = [layer for layer in getattr(self, name) if isinstance(layer, nn.Conv2d)]
            for index, layer in enumerate(layers):
                w = layer.weight
                out[f"{name}.{index}.w"] = w[:, :, 0, 0] if w.shape[-1] == 1 else w
                out[f"{name}.{index}.b"] = layer.bias
        return out


class Attention(nn.Module):
    """x + MLP([x ; o(attention(x))]) with four heads in contiguous channel blocks."""

    def __init__(self, d, heads, folded):
        super().__init__()
        self.heads, self.folded = heads, folded
        self.q, self.k, self.v, self.o = (nn.Linear(d, d) for _ in range(4))
        self.ffn = nn.ModuleList([nn.Linear(2 * d, 2 * d), nn.Linear(2 * d, d)])

    def fold(self):
        """The exact simplifications that Landline makes at import: one product for q, k and v, no key bias, o in the MLP."""
        d = self.q.weight.shape[0]
        own, message = self.ffn[0].weight[:, :d].double(), self.ffn[0].weight[:, d:].double()
        o, ob, vb = self.o.weight.double(), self.o.bias.double(), self.v.bias.double()
        scale = (d // self.heads) ** -0.5
        self.qkv = nn.Linear(d, 3 * d)
        self.own = nn.Linear(d, 2 * d)
        self.message = nn.Linear(d, 2 * d, bias=False)
        with torch.no_grad():
            self.qkv.weight[:] = torch.cat([self.q.weight * scale, self.k.weight, self.v.weight])
            self.qkv.bias[:] = torch.cat([self.q.bias * scale, torch.zeros(2 * d)])
            self.own.weight[:] = own
            self.own.bias[:] = self.ffn[0].bias.double() + message @ (o @ vb + ob)
            self.message.weight[:] = message @ o

    def forward(self, x):
        n, d = x.shape
        split = lambda t: t.reshape(n, self.heads, d // self.heads).transpose(0, 1)
        if self.folded:
            q, k, v = (split(t) for t in self.qkv(x).split(d, -1))
        else:
            q, k, v = split(self.q(x)) * (d // self.heads) ** -0.5, split(self.k(x)), split(self.v(x))
        message = ((q @ k.transpose(1, 2)).softmax(-1) @ v).transpose(0, 1).reshape(n, d)
        if self.folded:
            hidden = self.own(x) + self.message(message)
        else:
            hidden = self.ffn[0](torch.cat([x, self.o(message)], -1))
        return x + self.ffn[1](F.relu(hidden))


def named_mlps_and_attention(branch, prefix):
    """Weights of `prune`, `head` and `attn` under the names of Landline's files."""
    out = {}
    for name in ["prune", "head"]:
        layers = [layer for layer in getattr(branch, name) if isinstance(layer, nn.Linear)]
        for index, layer in enumerate(layers):
            out[f"{prefix}.{name}.{index}.w"], out[f"{prefix}.{name}.{index}.b"] = layer.weight, layer.bias
    for index, layer in enumerate(branch.attn):
        parts = {part: getattr(layer, part) for part in "qkvo"} | {f"ffn.{i}": layer.ffn[i] for i in (0, 1)}
        for part, linear in parts.items():
            name = f"{prefix}.attn.{index}.{part}"
            out[f"{name}.w"], out[f"{name}.b"] = linear.weight, linear.bias
    return out


class PointBranch(nn.Module):
    """The paper's point branch with every keypoint kept: [n, 256] to logits [n, 1] and coordinates [n, 3]."""

    def __init__(self, folded):
        super().__init__()
        linear = lambda *sizes: chain([nn.Linear(a, b) for a, b in zip(sizes, sizes[1:])], relu_last=False)
        self.prune = linear(256, 256, 1)
        self.attn = nn.ModuleList(Attention(256, 4, folded) for _ in range(5))
        self.head = linear(256, 512, 1024, 1024, 512, 3)

    def forward(self, x):
        logits = self.prune(x)
        for layer in self.attn:
            x = layer(x)
        return logits, self.head(x)

    def named(self):
        return named_mlps_and_attention(self, "point")


class SuperPoint(nn.Module):
    """The first release; from a grey picture [1, 1, H, W] to unit descriptors and keypoint probabilities."""

    def __init__(self):
        super().__init__()
        sizes = [1, 64, 64, 64, 64, 128, 128, 128, 128]
        self.encoder = nn.ModuleList(conv(i, o) for i, o in zip(sizes, sizes[1:]))
        self.detector = nn.ModuleList([conv(128, 256), nn.Conv2d(256, 65, 1)])
        self.descriptor = nn.ModuleList([conv(128, 256), nn.Conv2d(256, 256, 1)])

    def forward(self, x):
        for index, layer in enumerate(self.encoder):
            x = F.relu(layer(x))
            if index in (1, 3, 5):
                x = F.max_pool2d(x, 2)
        head = lambda layers: layers[1](F.relu(layers[0](x)))
        heat = F.pixel_shuffle(head(self.detector).softmax(1)[:, :64], 8)
        features = head(self.descriptor)
        return features / features.square().sum(1, keepdim=True).sqrt().clamp_min(1e-12), heat

    def named(self):
        out = {}
        for name in ["encoder", "detector", "descriptor"]:
            for index, layer in enumerate(getattr(self, name)):
                w = layer.weight
                out[f"{name}.{index}.w"] = w[:, :, 0, 0] if w.shape[-1] == 1 else w
                out[f"{name}.{index}.b"] = layer.bias
        return out


class LineBranch(nn.Module):
    """The paper's line branch with every segment kept, as published: [n * 12, 256] to logits [n, 1] and ends [n, 6]."""

    def __init__(self):
        super().__init__()
        linear = lambda *sizes: chain([nn.Linear(a, b) for a, b in zip(sizes, sizes[1:])], relu_last=False)
        self.q, self.k, self.v, self.o = (nn.Linear(256, 256) for _ in range(4))
        self.ff1, self.ff2 = nn.Linear(256, 1024), nn.Linear(1024, 256)
        self.ln1, self.ln2 = nn.LayerNorm(256, 1e-6), nn.LayerNorm(256, 1e-6)
        self.attn = nn.ModuleList([Attention(256, 4, False)])
        self.prune = linear(256, 256, 1)
        self.head = linear(256, 512, 1024, 512, 6)

    def forward(self, tokens):
        x = tokens.reshape(-1, 12, 256)
        split = lambda t: t.reshape(-1, 12, 4, 64).transpose(1, 2)
        q, k, v = split(self.q(x)) / 8, split(self.k(x)), split(self.v(x))
        message = ((q @ k.transpose(2, 3)).softmax(-1) @ v).transpose(1, 2).reshape(x.shape)
        y = self.ln1(x + self.o(message))
        y = self.ln2(y + self.ff2(F.gelu(self.ff1(y))))[:, 0]
        y = self.attn[0](y)
        return self.prune(y), self.head(y)

    def named(self):
        out = {}
        for name, layer in [(part, getattr(self, part)) for part in ("q", "k", "v", "o", "ff1", "ff2")]:
            out[f"line.enc.{name}.w"], out[f"line.enc.{name}.b"] = layer.weight, layer.bias
        for name in ("ln1", "ln2"):
            norm = getattr(self, name)
            out[f"line.enc.{name}.g"], out[f"line.enc.{name}.b"] = norm.weight, norm.bias
        return out | named_mlps_and_attention(self, "line")


class Product(nn.Module):
    def __init__(self, k, n):
        super().__init__()
        self.b = nn.Parameter(torch.rand(k, n) * 2 - 1)

    def forward(self, a):
        return a @ self.b


PRODUCTS = [(960, 256, 256), (480, 512, 512), (1024, 256, 1024)]
CONVOLUTIONS = [(120, 160, 64, 64, 1), (60, 80, 64, 64, 1), (120, 160, 24, 24, 1)]


def gain(module):
    """Weights that keep the activations' size through ReLU layers, so that no result is made of rounding only."""
    for layer in module.modules():
        if isinstance(layer, (nn.Linear, nn.Conv2d)):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.uniform_(layer.bias, -0.1, 0.1)


def export(module, inputs, path):
    torch.onnx.export(module, inputs, path, opset_version=17, dynamo=False, do_constant_folding=True)


def build():
    """All networks with their inputs, the same in every call."""
    torch.manual_seed(7)
    xfeat = XFeat().eval()
    gain(xfeat)
    plain = PointBranch(False).eval()
    gain(plain)
    folded = PointBranch(True).eval()
    folded.load_state_dict(plain.state_dict())
    for layer in folded.attn:
        layer.fold()
    gray = torch.rand(1, 1, 480, 640)
    descriptors = F.normalize(torch.randn(1024, 256), dim=-1)
    return xfeat, plain, folded, gray, descriptors


def build_native():
    """What only native.py times: SuperPoint, the line branch, and tokens of 300 segments."""
    torch.manual_seed(8)
    superpoint, line = SuperPoint().eval(), LineBranch().eval()
    gain(superpoint)
    gain(line)
    return superpoint, line, F.normalize(torch.randn(300 * 12, 256), dim=-1)


def main():
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    xfeat, plain, folded, gray, descriptors = build()
    superpoint, line, tokens = build_native()
    with torch.no_grad():
        for name, network in [("xfeat", xfeat), ("point", plain), ("superpoint", superpoint), ("line", line)]:
            tensors = {key: value.detach().contiguous() for key, value in network.named().items()}
            save_file(tensors, folder / f"{name}.safetensors")
        gray.numpy().tofile(folder / "gray.f32")
        descriptors.numpy().tofile(folder / "descriptors.f32")
        export(xfeat, (gray,), folder / "xfeat.onnx")
        export(superpoint, (gray,), folder / "superpoint.onnx")
        export(line, (tokens,), folder / "line_300.onnx")
        for n in (512, 1024):
            export(plain, (descriptors[:n],), folder / f"point_{n}.onnx")
            export(folded, (descriptors[:n],), folder / f"point_{n}_folded.onnx")
        for m, k, n in PRODUCTS:
            export(Product(k, n), (torch.rand(m, k),), folder / f"product_{m}_{k}_{n}.onnx")
        for h, w, i, o, stride in CONVOLUTIONS:
            export(chain([conv(i, o, stride)]), (torch.rand(1, i, h, w),), folder / f"conv_{h}_{w}_{i}_{o}_{stride}.onnx")
        unit, heat, reliability = xfeat(gray)
        print("features", tuple(unit.shape), "heat", float(heat.max()), "reliability", float(reliability.mean()))
        a, b = plain(descriptors)[1], folded(descriptors)[1]
        print("plain against folded", float((a - b).abs().max() / a.abs().max()))


if __name__ == "__main__":
    main()
