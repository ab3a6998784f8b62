"""Time and memory of poses from pictures alone, against the number of pictures, as a table and a plot.

    cargo build --release -p landline-mapper --no-default-features
    python3 benches/motion_sizes.py target/release/landline PICTURES STEP FEATURES OUT.svg [PEER ...]

The first 25, 50, 100, 200 and 300 of every STEP-th picture; FEATURES is a folder of features (`landline poses --features`), filled
beforehand, so that reading pictures is not measured. PEER is a command for another program on the same pictures: `{n}` in it
becomes their number. Processor seconds and largest memory are those that the system counts, so that other work on the machine does
not lengthen them. Needs nothing but Python.
"""

import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

SIZES = (25, 50, 100, 200, 300)
WIDTH, HEIGHT, LEFT, BOTTOM = 420, 260, 56, 36


def measured(command):
    """Runs a command; processor seconds, largest memory in MB, and whether it succeeded."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, process.returncode == 0


def panel(left, title, unit, curves):
    """One plot with logarithmic axes."""
    values = [v for curve in curves.values() for _, v in curve]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    first, last = math.log10(SIZES[0]), math.log10(SIZES[-1])

    def place(n, value):
        x = left + LEFT + (WIDTH - LEFT - 20) * (math.log10(n) - first) / (last - first)
        y = 30 + (HEIGHT - BOTTOM - 30) * (high - math.log10(value)) / (high - low)
        return x, y

    out = [f'<text x="{left + LEFT}" y="18" class="title">{title}</text>']
    for power in range(low, high + 1):
        _, y = place(SIZES[0], 10.0**power)
        out.append(f'<line x1="{left + LEFT}" x2="{left + WIDTH - 20}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>')
        out.append(f'<text x="{left + LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{10.0**power:g} {unit}</text>')
    for n in SIZES:
        x, _ = place(n, 10.0**low)
        out.append(f'<text x="{x:.1f}" y="{HEIGHT - 18}" text-anchor="middle">{n}</text>')
    for k, (name, curve) in enumerate(curves.items()):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (place(*at) for at in curve))
        out.append(f'<polyline points="{points}" class="c{k}"/>')
        x, y = place(*curve[-1])
        out.append(f'<text x="{x - 4:.1f}" y="{y + 34 if k == 0 else y - 8:.1f}" text-anchor="end" class="t{k}">{name}</text>')
    return out


def main(tool, pictures, step, features, plot, *peer):
    """Measures each size, prints a row for it, and writes the plot."""
    names = sorted(p for p in Path(pictures).iterdir() if p.suffix in (".jpg", ".png"))[:: int(step)]
    curves = {}
    print("| pictures | processor, s | memory, MB |" + (" peer, s | peer, MB |" if peer else ""))
    for n in (n for n in SIZES if n <= len(names)):
        with tempfile.TemporaryDirectory() as folder:
            film = Path(folder) / "film"
            film.mkdir()
            for name in names[:n]:
                (film / name.name).symlink_to(name.resolve())
            commands = {"landline": [tool, "poses", film, "--out", Path(folder) / "model", "--features", features]}
            if peer:
                commands["peer"] = [part.replace("{n}", str(n)) for part in peer]
            cells = [str(n)]
            for name, command in commands.items():
                seconds, megabytes, is_done = measured([str(part) for part in command])
                if not is_done:
                    sys.exit(f"{name} failed with {n} pictures")
                curves.setdefault(("s", name), []).append((n, seconds))
                curves.setdefault(("MB", name), []).append((n, megabytes))
                cells += [f"{seconds:.1f}", f"{megabytes:.0f}"]
            print("| " + " | ".join(cells) + " |", flush=True)
    body = []
    for k, (unit, title) in enumerate((("s", "processor seconds"), ("MB", "largest memory"))):
        body += panel(k * WIDTH, title, unit, {name: curve for (u, name), curve in curves.items() if u == unit})
    style = (
        "text{font:12px sans-serif;fill:#444}.title{font-weight:600}.grid{stroke:#ddd}polyline{fill:none;stroke-width:2}"
        ".c0{stroke:#0b6e99}.c1{stroke:#b4551d}.t0{fill:#0b6e99}.t1{fill:#b4551d}"
    )
    Path(plot).write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * WIDTH} {HEIGHT}" role="img" '
        f'aria-label="Time and memory against the number of pictures"><style>{style}</style><rect width="100%" height="100%" fill="#fff"/>'
        + "".join(body)
        + f'<text x="{WIDTH}" y="{HEIGHT - 2}" text-anchor="middle">pictures</text></svg>\n'
    )


if __name__ == "__main__":
    if len(sys.argv) < 6:
        sys.exit(__doc__)
    main(*sys.argv[1:])
