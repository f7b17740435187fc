"""How well does `dynid monitor` notice contacts? A simulated UR5e, controller, friction and noise included.

    python -m studies.monitor.contacts [MINUTES [LOADS]]

Prints false alarms in MINUTES (5) of motion that the thresholds were not learnt on, for each observer; for pushes of
twice the stated smallest force, on each link in six directions, the share found, within 30 ms too, and the delay; at
which multiple of the stated force 95 % are found; the time until a live watch asks for a stop; the same against
thresholds that are constant per joint; errors of a 2 kg load that is picked up, 5 s of motion later, over LOADS (20)
motions; processor time per second of samples. About 80 s of processor time.
"""

from __future__ import annotations

import os
import sys
import time as clock
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from drivers.streams import Batch, ChannelLayout, StreamLayout
from ident.model.dynamic_model import build_model
from ident.model.dynamics.link_jacobian import LinkJacobians, link_end
from ident.monitor.choices import Kind
from ident.monitor.contact_forces import force_noticed
from ident.monitor.interval_torque import IntervalTorque, JointSamples
from ident.monitor.labelled_contacts import LabelledContact, found_at, operating_point, roc
from ident.monitor.live import LiveMonitor
from ident.monitor.monitor import Monitor, earned_thresholds, joint_samples
from ident.monitor.thresholds import Thresholds
from ident.result.models.model import Model
from ident.tasks.identification import identify
from ident.tasks.monitoring import forces_noticed
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.synthetic.controlled_run import record_plant

RATE = 500.0
DURATION = 30.0
PUSH, EVERY = 0.2, 0.6
"""Length of a push, and from one to the next [s]."""
WITHIN = 0.03
CATCHING_UP, PICKED = 1.0, 4.0
"""When a run begins to count, and when a load is picked up [s]."""
REPEATS = 4
"""Pushes in every place of a run."""
BEFORE = 0.3
"""[s] for which a live watch has seen samples before a push."""
KINDS: tuple[Kind, ...] = ("momentum", "direct", "kalman")
ROBOT = load_robot("ur5e")
ARM = build_model(ROBOT)


def run(seed: int, duration: float = DURATION, contact: str = "") -> JointSamples:
    """A random motion of the simulated arm."""
    motion = random_fourier_motion(ARM, duration, seed)
    plant = Plant(ROBOT, seed=seed, position=motion.evaluate(np.zeros(1))[0][:, 0])
    if contact:
        plant.contacts.request(contact)
    recording = record_plant(ROBOT, plant, motion, RATE)
    if not MODEL:
        MODEL.append(identify(recording).model)  # the first run is that of the identification
    # The arm begins at rest, its motion does not: until it has caught up, nothing is learnt, and nothing watched.
    return rows(joint_samples(MODEL[0], recording), slice(round(CATCHING_UP * RATE), None))


MODEL: list[Model] = []


def pushed(
    model: Model, samples: JointSamples, thresholds: Thresholds, multiple: float, generator: np.random.Generator
) -> tuple[JointSamples, list[tuple[int, LabelledContact]]]:
    """The samples with forces added to the torques: a multiple of the smallest that is stated for the moment's pose and
    way of motion; and for each push its link and when it was."""
    arm, tool = model.dynamics.model, np.array(model.stored.robot_file.robot.workspace.tool)
    places = LinkJacobians(arm)
    velocity = np.gradient(samples.position, samples.time, axis=0)
    ways, _ = thresholds.ways.of(velocity, np.full(arm.dof, np.inf))
    torque, contacts = samples.torque.copy(), []
    directions = [(link, axis, sign) for link in range(1, len(arm.joints)) for axis in range(3) for sign in (1.0, -1.0)]
    starts = np.arange(1.0, samples.time[-1] - samples.time[0] - 1.0, EVERY)
    order = generator.permutation(len(starts))
    for number, start in zip(order, starts, strict=True):
        link, axis, sign = directions[number % len(directions)]
        first = int(np.searchsorted(samples.time, samples.time[0] + start))
        places.move(samples.position[first])
        lever = places.jacobian(link, link_end(arm, link, tool))[:3]
        needed = thresholds.noticed[ways[first], np.arange(arm.dof)]
        size = force_noticed(np.abs(lever), needed)[axis]
        if not np.isfinite(size):
            continue
        last = first + round(PUSH / thresholds.period)
        for row in range(first, last):
            places.move(samples.position[row])
            torque[row] -= multiple * sign * size * places.jacobian(link, link_end(arm, link, tool))[axis]
        contacts.append((link, LabelledContact(float(samples.time[first]), float(samples.time[last]))))
    return replace(samples, torque=torque), contacts


def delays(model: Model, samples: JointSamples, thresholds: Thresholds, contacts: list[LabelledContact]) -> FloatArray:
    """Time [s] from each contact's start to the first sample over its threshold; inf where there is none."""
    watched = Monitor(model, thresholds, load=False)
    residuals = watched.add(samples)
    stamps = residuals.intervals.time[residuals.ratio > 1.0] + watched.lag
    found = []
    for contact in contacts:
        during = stamps[(stamps >= contact.start) & (stamps <= contact.end)]
        found.append(float(during[0] - contact.start) if len(during) else np.inf)
    return np.array(found)


def main() -> None:
    """Print the tables."""
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    loads = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    quiet = [(str(seed), run(seed)) for seed in (1, 2, 3, 4)]
    model = MODEL[0]
    thresholds = {kind: earned_thresholds(model, quiet, kind=kind) for kind in KINDS}
    others = [run(100 + number) for number in range(round(60.0 * minutes / DURATION))]
    print(
        f"| observer | false alarms in {minutes:g} min | smallest force at the tool, x y z, median pose [N] | found at "
        "twice the stated force [%] | within 30 ms [%] | on the worst link [%] | median delay [ms] | 95 % delay [ms] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind in KINDS:
        alarms = 0
        for samples in others:
            watched = Monitor(model, thresholds[kind], load=False)
            watched.add(samples)
            alarms += len(watched.contacts)
        generator = np.random.default_rng(1)
        late, links = [], []
        for samples in others[:6]:
            with_force, contacts = pushed(model, samples, thresholds[kind], 2.0, generator)
            late.append(delays(model, with_force, thresholds[kind], [contact for _, contact in contacts]))
            links += [link for link, _ in contacts]
        delay = np.concatenate(late)
        worst = min(float(np.mean(delay[np.array(links) == link] <= WITHIN)) for link in set(links))
        forces = forces_noticed(model, thresholds[kind], quiet[0][1].position[::400])[-1].moving
        print(
            f"| {kind} | {alarms} | {', '.join(f'{force:.1f}' for force in forces)} | "
            f"{100 * np.mean(np.isfinite(delay)):.1f} | {100 * np.mean(delay <= WITHIN):.1f} | {100 * worst:.1f} | "
            f"{1e3 * np.median(delay):.0f} | {1e3 * np.quantile(delay, 0.95):.0f} |",
            flush=True,
        )
    print(f"\n{len(delay)} pushes of {PUSH:g} s each.\n")

    kind = "direct"
    stated_forces(model, others[:2], thresholds[kind])
    stops(model, others[0], thresholds[kind])
    compare(others[:4], thresholds[kind])
    payloads(loads, thresholds[kind])
    samples = others[0]
    begun = clock.process_time()
    source = IntervalTorque(model, 1.0 / RATE, momentum=False)
    count = 2000
    for start in range(0, count, 5):
        part = slice(start, start + 5)
        source.add(JointSamples(samples.time[part], samples.position[part], samples.torque[part]))
    used = (clock.process_time() - begun) / (count / RATE)
    print(f"external torque in batches of 10 ms: {used:.2f} s of processor time per second")


def stated_forces(model: Model, runs: list[JointSamples], thresholds: Thresholds) -> None:
    """Smallest multiple of the stated force at which pushes are found: residuals are linear in the force."""
    generator = np.random.default_rng(2)
    found: list[tuple[int, float]] = []
    for samples in runs:
        without = Monitor(model, thresholds, load=False).add(samples)
        for _ in range(REPEATS):
            with_force, contacts = pushed(model, samples, thresholds, 1.0, generator)
            share = Monitor(model, thresholds, load=False).add(with_force).external - without.external
            for link, contact in contacts:
                at = slice(*np.searchsorted(without.intervals.time, [contact.start, contact.end]))
                size, external = np.abs(share[at]), without.external[at] * np.sign(share[at])
                needed = np.divide(
                    without.threshold[at] - external, size, where=size > 1e-6, out=np.full_like(size, 1e9)
                )
                found.append((link, float(needed.min())))
    links, multiples = np.array([link for link, _ in found]), np.array([multiple for _, multiple in found])
    print("| link | pushes | half are found at this multiple of the stated force | 95 % at |\n|---|---|---|---|")
    for link in np.unique(links):
        of, name = multiples[links == link], model.dynamics.model.link_names[link]
        print(f"| {name} | {len(of)} | {np.median(of):.2f} | {np.quantile(of, 0.95):.2f} |")
    print(f"| all | {len(found)} | {np.median(multiples):.2f} | {np.quantile(multiples, 0.95):.2f} |\n", flush=True)


def stops(model: Model, samples: JointSamples, thresholds: Thresholds) -> None:
    """Time from a force until a session is asked to stop: samples one by one, as a connection delivers them."""
    generator = np.random.default_rng(4)
    with_force, contacts = pushed(model, samples, thresholds, 2.0, generator)
    robot = model.stored.robot_file.robot
    current = with_force.torque / np.array([robot.drive(name).gain for name in robot.joint_names], dtype=np.float64)
    channels = tuple(ChannelLayout(quantity, robot.joint_names) for quantity in ("position", "current"))
    late = []
    for _, contact in contacts:
        watch = LiveMonitor(model, thresholds, stops=True)
        watch.begin([StreamLayout("joints", channels, RATE)])
        first, begun, last = np.searchsorted(samples.time, [contact.start - BEFORE, contact.start, contact.end])
        # samples are evaluated a few at a time: a push may begin at any of them
        for row in range(int(first + generator.integers(5)), int(last)):
            at = slice(row, row + 1)
            values = {"position": with_force.position[at], "current": current[at]}
            watch.add(Batch("joints", samples.time[at], samples.time[at], values))
            if watch.stop_reason():
                late.append(float(samples.time[row] - samples.time[begun - 1]))
                break
    middle, most = np.quantile(late, [0.5, 0.95])
    print("| pushes | asked to stop | median [ms] | 95 % [ms] | longest [ms] |\n|---|---|---|---|---|")
    print(
        f"| {len(contacts)} | {len(late)} | {1e3 * middle:.0f} | {1e3 * most:.0f} | {1e3 * max(late):.0f} |\n",
        flush=True,
    )


def compare(runs: list[JointSamples], thresholds: Thresholds) -> None:
    """Detectors on pushes of one size in all places, twice the median of what is stated."""
    generator = np.random.default_rng(3)
    ratios: dict[str, list[FloatArray]] = {}
    stamps, contacts, hours, shift = [], [], 0.0, 0.0
    for samples in runs:
        with_force, labelled = pushed(MODEL[0], samples, thresholds, 2.0, generator)
        residuals = Monitor(MODEL[0], thresholds, load=False).add(with_force)
        stamps.append(residuals.intervals.time + shift)
        contacts += [LabelledContact(one.start + shift, one.end + shift) for _, one in labelled]
        hours += (DURATION - CATCHING_UP - PUSH * len(labelled)) / 3600.0
        external, drive = np.abs(residuals.external), np.abs(residuals.intervals.measured)
        for name, ratio in {
            "external torque, earned thresholds": residuals.ratio,
            "external torque, one threshold per joint": np.max(external / thresholds.limit.max(axis=0), axis=1),
            "drive torque, one threshold per joint": np.max(drive / thresholds.torque_limit, axis=1),
        }.items():
            ratios.setdefault(name, []).append(ratio)
        shift += 1000.0
    time = np.concatenate(stamps)
    print(
        "| detector | found at its threshold [%] | false alarms there | found without a false alarm [%] | found at 60 "
        "false alarms per hour [%] | at 600 [%] |"
    )
    print("|---|---|---|---|---|---|")
    for name, parts in ratios.items():
        ratio = np.concatenate(parts)
        chosen, curve = operating_point(time, ratio, contacts, 1.0, hours), roc(time, ratio, contacts, hours)
        shares = [100.0 * found_at(curve, rate).found for rate in (0.0, 60.0, 600.0)]
        print(
            f"| {name} | {100 * chosen.found:.1f} | {chosen.false_per_hour * hours:.0f} | "
            + " | ".join(f"{share:.1f}" for share in shares)
            + " |",
            flush=True,
        )
    print(f"\n{len(contacts)} pushes in {60.0 * hours:.1f} min without.\n")


def payloads(loads: int, thresholds: Thresholds) -> None:
    """Masses 5 s after a load of 2 kg was picked up in motion."""
    errors, inside = [], 0
    for number in range(loads):
        samples = run(300 + number, 12.0, f"pick 2 at 0 0 0.05 after {PICKED:g}")
        watched = Monitor(MODEL[0], thresholds)
        watched.add(rows(samples, slice(0, round((PICKED + 5.0 - CATCHING_UP) * RATE))))
        load = watched.load
        if load is None or not watched.contacts:
            errors.append(np.nan)
            continue
        errors.append(load.mass - 2.0)
        inside += abs(load.mass - 2.0) <= load.margin
    size = np.abs(np.array(errors))
    print("| loads | error of the mass after 5 s, median [%] | largest [%] | within 2 % | within the 95 % interval |")
    print("|---|---|---|---|---|")
    print(
        f"| {loads} | {50 * np.nanmedian(size):.1f} | {50 * np.nanmax(size):.1f} | {np.sum(size <= 0.04)} of {loads} | "
        f"{inside} of {loads} |\n",
        flush=True,
    )


def rows(samples: JointSamples, part: slice) -> JointSamples:
    """Some consecutive samples."""
    celsius = None if samples.celsius is None else samples.celsius[part]
    return JointSamples(samples.time[part], samples.position[part], samples.torque[part], celsius)


if __name__ == "__main__":
    main()
