"""Times the networks natively, one thread, beside PyTorch and onnxruntime, in one process and interleaved.

    python native.py FOLDER LIBNN_PEERS.so

FOLDER is what networks.py made. Prints milliseconds of processor time, fastest and median of each engine, and the ratios
(theirs / ours). Before that it compares the outputs of all engines, and of the wasm build if wasm.mjs left them in FOLDER,
with a double-precision pass of PyTorch.
"""

import ctypes
import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime
import torch

from networks import CONVOLUTIONS, PRODUCTS, build, build_native

torch.set_num_threads(1)
folder, library = Path(sys.argv[1]), ctypes.CDLL(str(Path(sys.argv[2]).resolve()))
library.run.argtypes = [ctypes.c_size_t, ctypes.c_void_p]
library.network_new.restype = library.convolution_new.restype = library.product_new.restype = ctypes.c_size_t
library.output.restype = ctypes.POINTER(ctypes.c_float)
library.output.argtypes = [ctypes.c_size_t, ctypes.c_size_t]


class Ours:
    def __init__(self, handle, data):
        self.handle, self.data = handle, np.ascontiguousarray(data, np.float32)

    def __call__(self):
        library.run(self.handle, self.data.ctypes.data)

    def output(self, index, count):
        return np.ctypeslib.as_array(library.output(self.handle, index), (count,)).copy()


def network(kind, name, width, height, data):
    weights = (folder / name).read_bytes()
    return Ours(library.network_new(kind, width, height, weights, len(weights)), data)


def session(name, data):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    onnx = onnxruntime.InferenceSession(folder / name, options, providers=["CPUExecutionProvider"])
    feed = {onnx.get_inputs()[0].name: np.ascontiguousarray(data, np.float32)}
    return lambda: onnx.run(None, feed)


def race(runs, rounds=24):
    times = [[] for _ in runs]
    start = time.process_time()
    while time.process_time() - start < 0.5:
        for run in runs:
            run()
    for _ in range(rounds):
        for index, run in enumerate(runs):
            before = time.process_time()
            run()
            times[index].append((time.process_time() - before) * 1e3)
    return times


def report(name, gflop, times, labels):
    cells = []
    for label, list_ in zip(labels, times):
        best, median = min(list_), float(np.median(list_))
        rate = f" {gflop / best * 1e3:.1f} GFLOP/s" if gflop else ""
        ratio = f" x{best / min(times[0]):.2f} (median x{median / float(np.median(times[0])):.2f})"
        cells.append(f"{label} {best:.2f} / {median:.2f} ms{rate}{'' if label == 'ours' else ratio}")
    print(f"{name}: {'; '.join(cells)}")


def off(a, truth):
    truth = np.asarray(truth, np.float64).ravel()
    return np.abs(np.asarray(a, np.float64).ravel() - truth).max() / np.abs(truth).max()


def compare(title, truth, found, wasm):
    rows = [(engine, [off(a, b) for a, b in zip(outputs, truth)]) for engine, outputs in found.items()]
    if all(path.exists() for path in wasm):
        outputs = [np.fromfile(path, np.float32) for path in wasm]
        rows.append(("ours in wasm", [off(a, b) for a, b in zip(outputs, truth)]))
        rows.append(("ours native against wasm", [off(a, b) for a, b in zip(found["ours"], outputs)]))
    for engine, differences in rows:
        print(f"  {title}, {engine}: off by {', '.join(f'{d:.1e}' for d in differences)}")


labels = ["ours", "PyTorch", "onnxruntime"]
xfeat, plain, folded, gray, descriptors = build()
with torch.inference_mode():
    for m, k, n in PRODUCTS:
        a, b = torch.rand(m, k), torch.rand(k, n)
        mine = Ours(library.product_new(m, k, n, 0), a)
        times = race([mine, lambda: a @ b, session(f"product_{m}_{k}_{n}.onnx", a)])
        report(f"product {m}x{k}x{n}", 2 * m * k * n / 1e9, times, labels)
    for h, w, i, o, stride in CONVOLUTIONS:
        x = torch.rand(1, i, h, w)
        layer = torch.nn.Sequential(torch.nn.Conv2d(i, o, 3, stride, 1), torch.nn.ReLU())
        mine = Ours(library.convolution_new(h, w, i, o, stride), x.permute(0, 2, 3, 1))
        times = race([mine, lambda: layer(x), session(f"conv_{h}_{w}_{i}_{o}_{stride}.onnx", x)])
        report(f"conv3x3 {i}-{o} {w}x{h}", 2 * 9 * h * w * i * o / 1e9, times, labels)

    mine, theirs = network(0, "xfeat.safetensors", 640, 480, gray), session("xfeat.onnx", gray)
    mine()
    last = lambda features, heat, reliability: [np.moveaxis(np.asarray(features)[0], 0, -1), heat, reliability]
    found = {
        "ours": [mine.output(0, 64 * 4800), mine.output(1, 307200), mine.output(2, 4800)],
        "PyTorch": last(*(t.numpy() for t in xfeat(gray))),
        "onnxruntime": last(*theirs()),
    }
    truth = last(*(t.numpy() for t in build()[0].double()(gray.double())))
    compare("XFeat", truth, found, [folder / f"wasm_xfeat_{index}.f32" for index in range(3)])
    report("XFeat 640x480", 2.62, race([mine, lambda: xfeat(gray), theirs]), labels)
    for n in (512, 1024):
        x = descriptors[:n]
        mine, theirs = network(2, "point.safetensors", n, 0, x), session(f"point_{n}.onnx", x)
        simple = session(f"point_{n}_folded.onnx", x)
        mine()
        found = {"ours": [mine.output(2, 3 * n)], "PyTorch": [plain(x)[1].numpy()], "onnxruntime": [theirs()[1]]}
        truth = [build()[1].double()(x.double())[1].numpy()]
        compare(f"point branch {n}", truth, found, [folder / f"wasm_point_{n}.f32"])
        times = race([mine, lambda: plain(x), theirs, simple])
        report(f"point branch, {n} keypoints", 0, times, labels + ["onnxruntime, simplified network"])

    superpoint, line, tokens = build_native()
    mine, theirs = network(3, "line.safetensors", 300, 0, tokens), session("line_300.onnx", tokens)
    mine()
    found = {"ours": [mine.output(1, 1800)], "PyTorch": [line(tokens)[1].numpy()], "onnxruntime": [theirs()[1]]}
    compare("line branch 300", [build_native()[1].double()(tokens.double())[1].numpy()], found, [folder / "none"])
    report("line branch, 300 segments", 0, race([mine, lambda: line(tokens), theirs]), labels)
    mine, theirs = network(1, "superpoint.safetensors", 640, 480, gray), session("superpoint.onnx", gray)
    mine()
    last = lambda features, heat: [np.moveaxis(np.asarray(features)[0], 0, -1), heat]
    found = {
        "ours": [mine.output(0, 256 * 4800), mine.output(1, 307200)],
        "PyTorch": last(*(t.numpy() for t in superpoint(gray))),
        "onnxruntime": last(*theirs()),
    }
    truth = last(*(t.numpy() for t in build_native()[0].double()(gray.double())))
    compare("SuperPoint", truth, found, [folder / "none"])
    report("SuperPoint 640x480", 52.1, race([mine, lambda: superpoint(gray), theirs], 5), labels)
