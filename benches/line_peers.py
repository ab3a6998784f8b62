"""3D lines of `landline labels` beside those of LIMAP, on the same pictures, poses, segments and descriptors.

Both programs get the same line segments. LIMAP (pip install pylimap) triangulates them with its own options; which
segments of two pictures it tries is decided by the same descriptors (the ten best of each), for each picture's twenty
nearest neighbours in the list of common 3D points. Printed for both: number of lines, views and observations of a line,
distance of the observed ends to the projected line, and the share of each one's lines that the other has too.

    python3 -m venv VENV && VENV/bin/pip install pylimap safetensors
    landline labels DATA --train 0-199 --features CACHE --out labels.safetensors
    VENV/bin/python benches/line_peers.py labels.safetensors
"""

import argparse
import json
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from safetensors import safe_open

MIN_VIEWS = 4
MAX_DISTANCE_M = 0.05
MAX_ANGLE_DEG = 3.0
NUM_NEIGHBOURS = 20
NUM_CANDIDATES = 10


class Labels:
    """What the label file holds, by picture."""

    def __init__(self, path):
        with safe_open(path, framework="numpy") as file:
            header = json.loads(file.metadata()["labels"])
            get = file.get_tensor
            self.images = header["images"]
            samples = header["samples_per_segment"]
            segments = get("segments")[:, :4]
            descriptors = get("segment_descriptors").astype(np.float32)
            descriptors = descriptors.reshape(len(segments), samples, -1).mean(axis=1)
            descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True) + 1e-12
            starts = np.cumsum([0] + [i["num_segments"] for i in self.images])
            self.segments = [segments[a:b] for a, b in zip(starts, starts[1:])]
            self.descriptors = [descriptors[a:b] for a, b in zip(starts, starts[1:])]
            self.lines = tracks(get("lines")[:, :6], get("line_track_lengths"), get("line_observations"))
            self.points = tracks(get("points")[:, :3], get("point_track_lengths"), get("point_observations"))
            keypoints = get("keypoints")[:, :2]
            starts = np.cumsum([0] + [i["num_keypoints"] for i in self.images])
            self.keypoints = [keypoints[a:b] for a, b in zip(starts, starts[1:])]
        self.rotations = [np.array(i["rotation_row_major"]).reshape(3, 3) for i in self.images]
        self.translations = [np.array(i["translation"]) for i in self.images]

    def intrinsics(self, i):
        camera = self.images[i]["camera"]
        p = camera["params"]
        if camera["model"] == "SIMPLE_PINHOLE":
            return p[0], p[0], p[1], p[2]
        if camera["model"] == "PINHOLE":
            return tuple(p)
        raise SystemExit(f"camera model {camera['model']}: undistort the pictures first")


def tracks(values, lengths, observations):
    """Pairs of coordinates and [(picture, feature)]."""
    ends = np.cumsum(lengths.ravel())
    return [
        (value, [tuple(o) for o in observations[end - length : end]])
        for value, length, end in zip(values, lengths.ravel(), ends)
    ]


def reconstruction(labels, pycolmap):
    """A COLMAP model of the pictures and points."""
    recon = pycolmap.Reconstruction()
    for i, image in enumerate(labels.images):
        fx, fy, cx, cy = labels.intrinsics(i)
        camera = pycolmap.Camera(
            model="PINHOLE",
            width=image["camera"]["width"],
            height=image["camera"]["height"],
            params=[fx, fy, cx, cy],
            camera_id=i + 1,
        )
        recon.add_camera_with_trivial_rig(camera)
        points2d = [pycolmap.Point2D(xy) for xy in labels.keypoints[i].astype(float)]
        picture = pycolmap.Image(image["name"], pycolmap.Point2DList(points2d), i + 1, i + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(labels.rotations[i]), labels.translations[i])
        recon.add_image_with_trivial_frame(picture, pose)
    for xyz, seen in labels.points:
        track = pycolmap.Track()
        for picture, keypoint in seen:
            track.add_element(int(picture) + 1, int(keypoint))
        recon.add_point3D(xyz, track)
    return recon


def neighbours(labels):
    """Of each picture the pictures with the most points in common."""
    common = [Counter() for _ in labels.images]
    for _, seen in labels.points:
        pictures = [int(p) for p, _ in seen]
        for a in pictures:
            common[a].update(b for b in pictures if b != a)
    return {i: [b for b, _ in counts.most_common(NUM_NEIGHBOURS)] for i, counts in enumerate(common)}


def run_limap(labels):
    """LIMAP's lines as [(six coordinates, [(picture, segment)])], and seconds."""
    import limap.sfm
    import pycolmap
    from limap.geometry import Line2d
    from limap.scene import (
        HolisticReconstruction,
        Structure2d,
        StructureDatabase,
        StructureDatabaseCache,
    )

    recon = reconstruction(labels, pycolmap)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "structures.db"
        with StructureDatabase.open(path) as database:
            for i, segments in enumerate(labels.segments):
                structure = Structure2d()
                structure.set_num_points(len(labels.keypoints[i]))
                structure.set_lines([Line2d(s[:2].copy(), s[2:].copy()) for s in segments])
                database.write_structure2d(i + 1, structure)
            for a, others in neighbours(labels).items():
                for b in others:
                    if a > b or database.exists_line_matches(a + 1, b + 1):
                        continue
                    similarity = labels.descriptors[a] @ labels.descriptors[b].T
                    best = np.argsort(-similarity, axis=1)[:, :NUM_CANDIDATES]
                    rows = np.repeat(np.arange(len(best)), best.shape[1])
                    matches = np.stack([rows, best.ravel()], axis=1).astype(np.uint32)
                    database.write_line_matches(a + 1, b + 1, matches)
            cache = StructureDatabaseCache.create(database)
        start, cpu = time.perf_counter(), time.process_time()
        holistic = HolisticReconstruction(recon)
        holistic.structure_recon.load(cache)
        options = limap.sfm.GlobalLineTriangulationOptions()
        options.use_vp_assisted_triangulation = False
        holistic.structure_recon.initialize_all_wireframes(options.wireframe2d_th)
        limap.sfm.global_line_triangulation(
            options, holistic, cache.structure_correspondence_graph.line_graph, {}
        )
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    lines = []
    for line in holistic.structure_recon.lines3D.values():
        seen = [(e.image_id - 1, e.point2D_idx) for e in elements(line.track)]
        lines.append((np.concatenate([line.start, line.end]), seen))
    return lines, seconds, cpu


def elements(track):
    return track.elements() if callable(track.elements) else track.elements


def distances_px(labels, line, seen):
    """Largest distance of each observed segment's ends to the projected infinite line."""
    out = []
    for picture, segment in seen:
        fx, fy, cx, cy = labels.intrinsics(picture)
        k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        a, b = (k @ (labels.rotations[picture] @ p + labels.translations[picture]) for p in (line[:3], line[3:]))
        normal = np.cross(a, b)
        normal /= np.hypot(*normal[:2]) + 1e-12
        ends = labels.segments[picture][segment]
        out.append(max(abs(normal @ [ends[0], ends[1], 1]), abs(normal @ [ends[2], ends[3], 1])))
    return out


def has_like(line, others):
    """Whether another line is the same: both ends near its infinite line, same direction, overlapping."""
    start, end = line[:3], line[3:]
    length = np.linalg.norm(end - start)
    direction = (end - start) / max(length, 1e-9)
    origins, ends = others[:, :3], others[:, 3:]
    along = ends - origins
    lengths = np.linalg.norm(along, axis=1)
    along = along / np.maximum(lengths, 1e-9)[:, None]
    is_parallel = np.abs(along @ direction) >= np.cos(np.radians(MAX_ANGLE_DEG))

    def off(p):
        d = p - origins
        return np.linalg.norm(d - along * np.sum(d * along, axis=1, keepdims=True), axis=1)

    at = np.stack([np.sum((p - origins) * along, axis=1) for p in (start, end)])
    overlaps = (at.max(axis=0) > 0) & (at.min(axis=0) < lengths)
    return bool(np.any(is_parallel & overlaps & (off(start) < MAX_DISTANCE_M) & (off(end) < MAX_DISTANCE_M)))


def row(name, labels, lines, others):
    kept = [(line, seen) for line, seen in lines if len({p for p, _ in seen}) >= MIN_VIEWS]
    errors = [distances_px(labels, line, seen) for line, seen in kept]
    num_seen = sum(len(seen) for _, seen in kept)
    segments = sum(len(s) for s in labels.segments)
    other = np.array([line for line, seen in others if len({p for p, _ in seen}) >= MIN_VIEWS])
    shared = np.mean([has_like(line, other) for line, _ in kept])
    lengths = [np.linalg.norm(line[3:] - line[:3]) for line, _ in kept]
    views = np.mean([len({p for p, _ in seen}) for _, seen in kept])
    return (
        f"{name:10} {len(kept):6} {views:7.1f} {100 * num_seen / segments:9.1f} % {np.mean(np.concatenate(errors)):9.2f} "
        f"{np.median(np.concatenate(errors)):9.2f} {np.median(lengths):9.2f} {100 * shared:11.1f} %"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("labels", help="file of `landline labels`")
    args = parser.parse_args()
    labels = Labels(args.labels)
    peer, seconds, cpu = run_limap(labels)
    segments = sum(len(s) for s in labels.segments)
    print(f"{len(labels.images)} pictures, {segments} segments; lines seen in at least {MIN_VIEWS} pictures")
    print(f"{'':10} {'lines':>6} {'views':>7} {'segments':>11} {'mean px':>9} {'median px':>9} {'length':>9} {'other has it':>13}")
    print(row("landline", labels, labels.lines, peer))
    print(row("LIMAP", labels, peer, labels.lines))
    print(f"LIMAP's triangulation: {seconds:.1f} s, {cpu:.1f} s of processor time")


if __name__ == "__main__":
    main()
