"""How good retextured grooms are: a few strands' texture on four real grooms, measured on the files written.

python benchmarks/retexture.py [--method patches|finetune] [--jobs eve,bob,combover,straight] [--every N | --full]
                               [--seed N] [--halvings N] [--textures FOLDER]

eve, bob and combover take the texture of coily_swatch.obj; straight is coily_swatch.obj with the texture of two long
strands of eve. Each job reads, fits, retextures, writes, and reads the file back. Printed is one row a measure and
one column a job, each value with ok or FAIL where the measure has a bound; the exit status is 1 where one fails. The
grooms are looked for in DETANGLED_GROOMS, else in shared/grooms beside the repository.

Targets are measured with as many points a turn as the result has: centrelines, and so torsion in canonical space,
depend on it. Strands are measured about their own axis, extracted anew from the file; those of fewer than 6 turns
(wavelengths on their guide), which are too short for that, about the input's guide. Distributions of kappa and tau
are compared as ``distributions`` says.

Straight strands (targets whose radius is below 0.02 cm) have no wavelength and no torsion, and are all alike. With
them a strand is its own style guide: its distance from the input's guide is bounded by 0.02 cm instead of a radius,
and so is its radius about that guide.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import detangled
import measures
from detangled import Groom, Length, Options
from detangled.diffusion.sampler import DEFAULT_STEPS
from detangled.drawing import ToDraw, draw_strands
from detangled.engines import engine_of
from detangled.fitted import FINETUNE, METHODS, FittedTexture
from detangled.geometry.signal import curve_counts, curves
from detangled.geometry.winding import winding
from detangled.groom import offsets_of
from detangled.grooming.guides import style_guides
from detangled.units import CM_PER_UNIT

GROOMS = Path(os.environ.get("DETANGLED_GROOMS", Path(__file__).resolve().parents[2] / "shared" / "grooms"))

EVERY = {"eve": 10, "bob": 2, "combover": 50, "straight": 1}  # strands measured by default: every so many
SAMPLE = 48  # strands of the measures that compare all with all
LONGER, SHORTER = "longer than targets", "shorter than targets"
FEWEST_COMPARED = 10
END_TURNS = 1.5  # of a strand: there its axis is known least well
HALVINGS = 15  # of five the means still move by a third
HELD_OUT = 200  # new strands compared with targets that their texture was not fitted to
LENGTH_BOUND = 1e-3
GUIDE_BOUND = 1.0  # target radii
TEXTURE_BOUND = 0.2
WASSERSTEIN_BOUND = 2.0
WANDER_BOUND = 1.15
ALIKE_BOUND = 0.5  # of the least distance between two targets
ALIKE_LEAST = 0.05
STRAIGHT_RADIUS = 0.02  # [cm] two hairs' widths
# An even 0.01/cm bows a strand of 12 cm by 0.2 cm.
LEAST_CURVATURE = 0.01  # [1/cm]
FEWEST_WAVELENGTHS = 6.0
FEWEST_TURNS = 7.5  # that the shortest strands are synthesised with, before they are cut to length
POINTS_PER_TURN = 16


@dataclass
class Column:
    """One job's values: measure -> (text, whether it is within the bound, None where there is none)."""

    name: str
    cells: dict[str, tuple[str, bool | None]] = field(default_factory=dict)

    def put(self, measure: str, text: str, ok: bool | None = None) -> None:
        self.cells[measure] = (text, None if ok is None else bool(ok))


FITTED: dict[str, FittedTexture] = {}


@dataclass(frozen=True)
class Job:
    """Input strands and targets as they were read, a folder for files, the strands' seed, and how to fit.

    halvings: of the targets, to compare what is fitted to one half with the other. textures: a folder of fitted ones.
    """

    name: str
    groom: Groom
    targets: Groom
    folder: Path
    suffix: str
    seed: int
    method: str
    halvings: int
    textures: Path | None

    def fit(self, targets: Groom) -> FittedTexture:
        """Fit, once for the jobs that share their targets, and once for all where textures are kept."""
        key = hashlib.sha256(targets.points.tobytes()).hexdigest()[:16]
        kept = None if self.textures is None else self.textures / f"{self.method}_{key}.texture"
        if key not in FITTED and kept is not None and kept.is_file():
            FITTED[key] = detangled.load_texture(kept)
        elif key not in FITTED:
            FITTED[key] = detangled.fit(targets, self.method)
            if kept is not None:
                detangled.save_texture(FITTED[key], kept)
        return FITTED[key]

    def retextured(
        self, groom: Groom, texture: FittedTexture, length: Length, column: Column | None = None, draw: int = 0
    ) -> Groom:
        """Retexture, write, and read the file again. draw: with which seed after the job's."""
        path = self.folder / f"{self.name}{self.suffix}"
        began = time.perf_counter()
        result = detangled.retexture(groom, texture, Options(length, seed=self.seed + draw))
        made = time.perf_counter()
        detangled.write(result.groom, path)
        wrote = time.perf_counter()
        read = detangled.read(path, unit=_unit_name(groom))
        if column is not None:
            column.put("seconds: retexture", f"{made - began:.1f}")
            column.put("seconds: write, read", f"{wrote - made:.2f}, {time.perf_counter() - wrote:.2f}")
            column.put("points written", f"{len(read.points)}")
            column.put("peak memory so far [MB]", f"{_peak_megabytes():.0f}")
        return read


def _unit_name(groom: Groom) -> str:
    return next(name for name, cm in CM_PER_UNIT.items() if cm == groom.unit_cm)


def _peak_megabytes() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def prepare(name: str, every: int, folder: Path, options: argparse.Namespace, column: Column) -> Job:
    """Read a job's files; every so many strands of its input."""
    swatch = GROOMS / "coily_swatch.obj"
    source = swatch if name == "straight" else GROOMS / f"{name}.abc"
    target = swatch
    if name == "straight":
        eve = detangled.read(GROOMS / "eve.abc")
        chosen = np.argsort(-eve.polyline_lengths(), kind="stable")[[0, eve.strand_count // 4]]
        target = folder / "two_straight.obj"
        detangled.write(eve.select(np.sort(chosen)), target)
    began = time.perf_counter()
    groom = detangled.read(source)
    targets = detangled.read(target, unit="m" if name == "straight" else None)
    column.put("seconds: read", f"{time.perf_counter() - began:.2f}")
    groom = groom.select(np.arange(0, groom.strand_count, every))
    return Job(
        name,
        groom,
        targets,
        folder,
        source.suffix,
        options.seed,
        options.method,
        options.halvings,
        options.textures,
    )


def measure(job: Job, column: Column) -> None:
    """Run a job and fill its column."""
    rng = np.random.default_rng(job.seed)
    began = time.perf_counter()
    texture = job.fit(job.targets)
    column.put("seconds: fit", f"{time.perf_counter() - began:.2f}")
    usable = style_guides(job.groom)
    groom, guides = usable.groom, usable.as_groom()
    column.put("strands (of them with under 6 turns)", f"{groom.strand_count}")

    new = job.retextured(groom, texture, Length.GUIDE, column)
    straight = texture.radius < STRAIGHT_RADIUS
    roots(new, groom, column)
    lengths(job, texture, new, groom, guides, column)

    unit = max(texture.radius, STRAIGHT_RADIUS)
    extracted = style_guides(new).as_groom()
    found = [float(np.median(measures.distances(g, guides))) / unit for g in (extracted, new)]
    put(column, "guides from the input's, median [radii, or 0.02 cm]", found[1 if straight else 0], GUIDE_BOUND)
    column.put("  the same, extracted anew", f"{found[0]:.3g}")

    # A straight strand has no axis but the guide.
    long = np.full(groom.strand_count, not straight)
    if not straight:
        long = usable.lengths >= FEWEST_WAVELENGTHS * texture.wavelength
    column.put("strands (of them with under 6 turns)", f"{groom.strand_count} ({np.count_nonzero(~long)})")
    own, given = measures.own_axis(new), measures.given_axis(new, guides)
    targets = measures.refined(job.targets, texture.turn / POINTS_PER_TURN)
    aims = measures.own_axis(targets)
    windings(own, given, long, aims, straight, column)

    real = measures.strand_signals(aims, texture.cell_width)
    made = measures.strand_signals(measures.mixed(own, given, long), texture.cell_width)
    likeness(made, real, texture, straight, rng, column)
    ends = 0.0 if straight else END_TURNS * texture.turn
    distributions(job, groom, guides, aims, real, ends, rng, column)
    in_world(new, targets, texture.cell_width, column)
    axis_wander(texture, usable.lengths, job.seed, rng, column)


def put(column: Column, name: str, value: float, bound: float, text: str | None = None) -> None:
    """A value that must not be above a bound."""
    column.put(f"{name} <= {bound:g}", text or f"{value:.3g}", value <= bound)


def roots(new: Groom, groom: Groom, column: Column) -> None:
    """Roots must be what they were, to the bit of the file's float32."""
    old = groom.points[groom.offsets[:-1]]
    now = new.points[new.offsets[:-1]]
    same = np.array_equal((old / groom.unit_cm).astype(np.float32), (now / new.unit_cm).astype(np.float32))
    away = np.linalg.norm(old - now, axis=1).max()
    column.put("roots moved, most [cm] = 0 in float32", f"{away:.2g}", same and new.strand_count == groom.strand_count)


def lengths(job: Job, texture: FittedTexture, new: Groom, groom: Groom, guides: Groom, column: Column) -> None:
    errors = np.abs(measures.guide_length_errors(new, guides))
    text = f"{errors.max():.2%}, {np.percentile(errors, 99.9):.2%}"
    put(column, "--length guide: worst, 99.9 %", float(errors.max()), LENGTH_BOUND, text)
    arcs = job.retextured(groom, texture, Length.STRAND)
    errors = np.abs(measures.arc_length_errors(arcs, groom))
    text = f"{errors.max():.2%}, {np.percentile(errors, 99.9):.2%}"
    put(column, "--length strand: worst, 99.9 %", float(errors.max()), LENGTH_BOUND, text)


def windings(
    own: measures.Canonical,
    given: measures.Canonical,
    long: np.ndarray,
    targets: measures.Canonical,
    straight: bool,
    column: Column,
) -> None:
    """Radius and wavelength by winding: about the strand's own axis if long, about the input's guide if short."""
    radius, wavelength = winding(targets.points, targets.offsets)
    wanted = (float(np.median(radius)), float("nan") if straight else float(np.nanmedian(wavelength)))
    column.put("targets: radius, wavelength [cm]", f"{wanted[0]:.3g}, {wanted[1]:.3g}")
    for axis, canonical, judged in (("own axis", own, long), ("input's guide", given, ~long)):
        which = "6 turns or more" if axis == "own axis" else "under 6 turns"
        found = winding(canonical.points, canonical.offsets)
        if straight:
            # The median along a strand: its beginning leads from a root that stays where the curly strand had it.
            found = (measures.middle_radius(canonical), found[1])
        for what, values, want in zip(("radius", "wavelength"), found, wanted, strict=True):
            everyone = float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")
            column.put(f"  {what} about the {axis}, all [cm]", f"{everyone:.3g}")
            name = f"{what} about the {axis}, {which}: off"
            if not judged.any() or (straight and what == "wavelength"):
                column.put(f"{name} <= {TEXTURE_BOUND:g}", "-")
                continue
            off = float(np.nanmedian(values[judged])) - want
            if straight:
                text = f"{off:.2g} cm (<= {STRAIGHT_RADIUS})"
                column.put(f"{name} <= {TEXTURE_BOUND:g}", text, abs(off) <= STRAIGHT_RADIUS)
            else:
                put(column, name, abs(off) / want, TEXTURE_BOUND, f"{off / want:+.1%}")


def likeness(
    made: list[np.ndarray],
    real: list[np.ndarray],
    texture: FittedTexture,
    straight: bool,
    rng: np.random.Generator,
    column: Column,
) -> None:
    """No two strands alike, none a copy: distances of windows as long as the shortest target or the median strand."""
    length = int(min(min(len(s) for s in real), np.median([len(s) for s in made])))
    targets = measures.windows(real, texture.whitening, length)
    new = measures.windows(made, texture.whitening, length)
    some_targets, some = targets.one_a_strand(SAMPLE, rng), new.one_a_strand(SAMPLE, rng)
    floor = measures.nearest(some_targets, targets, True)
    column.put("  windows compared: cells, new, targets", f"{length}, {len(some.strand)}, {len(targets.strand)}")
    column.put("  target to target: least, median", f"{floor.min():.2f}, {np.median(floor):.2f}")
    bound = max(ALIKE_BOUND * float(floor.min()), ALIKE_LEAST)
    for name, distances in (
        ("new to target", measures.nearest(some, targets, False)),
        ("new to new", measures.nearest(some, new, True)),
    ):
        # Straight strands are all alike.
        ok = None if straight else float(distances.min()) >= bound
        text = f"{distances.min():.2f}, {np.median(distances):.2f}"
        column.put(f"{name}: least, median >= half of target to target", text, ok)


def distributions(
    job: Job,
    groom: Groom,
    guides: Groom,
    aims: measures.Canonical,
    real: list[np.ndarray],
    ends: float,
    rng: np.random.Generator,
    column: Column,
) -> None:
    """Wasserstein-1 of kappa and |tau| to targets that the fit has not seen, over the distance of those two halves.

    Means over several halvings. Strands whose guide is shorter than any target are compared as they lie in the world,
    style and all, with pieces of held-out targets as long as they are and set on the same guides; the distance of the
    halves is then that of such pieces too. None is cut from the targets' ends, ``ends`` [cm] of arc, where an axis is
    known least well; 0 for straight ones. Where there are few such guides, they are taken several times. Longer strands
    are straightened about the input's guide, and compared with whole targets.
    """
    kinds = ("kappa", "|tau|") if ends else ("kappa",)
    inner = measures.without_ends(aims, ends)
    # Cells of one width: wider ones would smooth more.
    width = float(real[0][:, 2].mean() / len(real[0]))
    lengths = style_guides(groom).lengths
    longer = lengths >= measures.axial_lengths(aims).min()
    shorter = lengths < measures.axial_lengths(inner).min()
    found: dict[str, list[tuple[tuple[float, float], tuple[float, float]]]] = {}
    for halving in range(job.halvings):
        order = np.random.default_rng([job.seed, halving]).permutation(len(real))
        seen, held_out = np.sort(order[: len(real) // 2]), order[len(real) // 2 :]
        chosen = np.sort(rng.permutation(groom.strand_count)[:HELD_OUT])
        texture = job.fit(job.targets.select(seen))
        for which, some in ((LONGER, chosen[longer[chosen]]), (SHORTER, chosen[shorter[chosen]])):
            if len(some) < FEWEST_COMPARED:
                continue
            strands, on = groom.select(some), guides.select(some)
            made_of_seen, pieces = [], [[], []]
            for draw in range(-(-HELD_OUT // len(some))):
                new = job.retextured(strands, texture, Length.GUIDE, draw=draw)
                if which == LONGER:
                    made = measures.given_axis(new, on)
                else:
                    made = measures.in_world(new)
                    for half, cut in zip((seen, held_out), pieces, strict=True):
                        piece = measures.pieces_on_guides(inner.select(half), strands, on, rng)
                        cut += measures.strand_signals(measures.in_world(piece), width)
                made_of_seen += measures.strand_signals(made, width)
            halves = [[real[i] for i in half] for half in (seen, held_out)] if which == LONGER else pieces
            distances = measures.wasserstein(made_of_seen, halves[1]), measures.wasserstein(*halves)
            found.setdefault(which, []).append(distances)
    for which, distances in found.items():
        if 2 * len(distances) < job.halvings:
            continue  # hardly ever enough of such strands to compare
        for kind, (value, floor) in zip(kinds, np.mean(distances, axis=0).T, strict=False):
            least = max(float(floor), LEAST_CURVATURE)
            text = f"{value / least:.2f} ({value:.3f} over {least:.3f}/cm)"
            put(
                column,
                f"W1 of {kind} to held-out targets over their halves', {which}",
                value / least,
                WASSERSTEIN_BOUND,
                text,
            )


def in_world(new: Groom, targets: Groom, cell_width: float, column: Column) -> None:
    """Curvature and torsion as the strands lie, style and all: no axis has to be found for them."""
    for kind, channel in (("kappa", 0), ("|tau|", 1)):
        texts = []
        for groom in (new, targets):
            found = measures.strand_signals(measures.in_world(groom), cell_width)
            low, high = np.percentile(np.abs(np.concatenate(found)[:, channel]), [50, 90])
            texts.append(f"{low:.2f}, {high:.2f}")
        column.put(f"  {kind} in the world, median, 90 % [1/cm]", f"{texts[0]} (targets {texts[1]})")


def axis_wander(
    texture: FittedTexture, guide_lengths: np.ndarray, seed: int, rng: np.random.Generator, column: Column
) -> None:
    """Centreline arc over chord of strands as they are drawn, before any guide, against the targets' rebuilt."""
    chosen = np.sort(rng.permutation(len(guide_lengths))[:SAMPLE])
    least = max(min(FEWEST_TURNS * texture.turn, texture.median_arc), texture.shortest_drawn)
    arcs = np.maximum(guide_lengths[chosen] * texture.arc_per_axis, least)
    none = np.zeros(len(arcs))
    what = ToDraw(arcs, arcs, chosen.astype(np.int64), cut=none > 0.0, straight=none > 0.0, dropped=none, spare=none)
    made = draw_strands(texture, what, seed, DEFAULT_STEPS, None, engine_of(texture))
    found = []
    for values, starts in ((texture.signals, texture.starts), (made.values, made.starts)):
        offsets = offsets_of(curve_counts(values, starts))
        found.append(measures.wander(curves(values, starts, offsets), offsets))
    target, new = (np.percentile(w, [50, 90]) for w in found)
    column.put("  targets' axis wander: median, 90 %", f"{target[0]:.3f}, {target[1]:.3f}")
    text = f"{new[0] / target[0]:.3f}, {new[1] / target[0]:.3f}"
    put(column, "axis wander over the targets' median: median, 90 %", new[0] / target[0], WANDER_BOUND, text)


def table(columns: list[Column]) -> str:
    names = list(dict.fromkeys(name for column in columns for name in column.cells))
    lines = [["", *(column.name for column in columns)]]
    for name in names:
        line = [name]
        for column in columns:
            text, ok = column.cells.get(name, ("-", None))
            line.append(text if ok is None else f"{text} {'ok' if ok else 'FAIL'}")
        lines.append(line)
    widths = [max(len(line[c]) for line in lines) for c in range(len(lines[0]))]
    return "\n".join("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)) for line in lines)


def warm_up() -> None:
    """Compile, or load what was compiled, so that seconds are the work's own."""
    swatch = detangled.read(GROOMS / "coily_swatch.obj").select([0, 1, 2])
    texture = detangled.fit(swatch)
    for length in Length:
        detangled.retexture(swatch, texture, Options(length))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", default=",".join(EVERY), help=f"default: {','.join(EVERY)}")
    parser.add_argument("--every", type=int, help="use every N-th strand; default: " + str(EVERY))
    parser.add_argument("--full", action="store_true", help="use every strand")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", choices=METHODS, default=METHODS[0])
    parser.add_argument(
        "--halvings", type=int, help=f"of the targets; default: {HALVINGS}, or 2 where a network is trained"
    )
    parser.add_argument("--textures", type=Path, help="keep what is fitted in this folder, and take it from there")
    options = parser.parse_args(arguments)
    if options.textures is not None:
        options.textures.mkdir(parents=True, exist_ok=True)
    options.halvings = options.halvings or (2 if options.method == FINETUNE else HALVINGS)
    jobs = options.jobs.split(",")
    if unknown := set(jobs) - set(EVERY):
        parser.error(f"no such job: {', '.join(sorted(unknown))}; these are: {', '.join(EVERY)}")

    warm_up()
    columns = []
    for name in jobs:
        every = 1 if options.full else options.every or EVERY[name]
        column = Column(f"{name} (every {every})" if every > 1 else name)
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            measure(prepare(name, every, Path(folder), options, column), column)
        column.put("seconds: all, with measuring", f"{time.perf_counter() - began:.0f}")
        columns.append(column)
        print(f"{name}: done", file=sys.stderr)
    print(table(columns))
    return int(any(ok is False for column in columns for _, ok in column.cells.values()))


if __name__ == "__main__":
    sys.exit(main())
