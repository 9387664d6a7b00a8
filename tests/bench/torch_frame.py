#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""torch_frame.py [DEVICE [FRAMES]]: the frame of table4.dr driven by PyTorch: our picture and gradient through autograd,
torch's loss and Adam. Beside it the same loop around an empty Function, and the frame without PyTorch, in turns.
Prints one JSON object for each size: microseconds a frame, medians of five turns. DRESSI_LIBRARY and PYTHONPATH say
where the package is."""
import json
import pathlib
import statistics
import subprocess
import sys
import time

import numpy as np
import torch

import dressi
import dressi.torch

HERE = pathlib.Path(__file__).resolve().parent


def sphere(around, rings):
    text = subprocess.run(
        ["awk", "-v", f"around={around}", "-v", f"rings={rings}", "-f", HERE / "uv_sphere.awk"],
        capture_output=True, text=True, check=True,
    ).stdout
    lines = [line.split() for line in text.splitlines()]
    position = np.array([line[1:] for line in lines if line[0] == "v"], np.float32)
    face = np.array([line[1:] for line in lines if line[0] == "f"], np.int32) - 1
    return position, face


class Empty(torch.autograd.Function):
    """What there is of a function that does nothing."""

    @staticmethod
    def forward(ctx, position, mask, gradient):
        ctx.save_for_backward(position)
        ctx.gradient = gradient
        return mask.detach()

    @staticmethod
    def backward(ctx, seed):
        return ctx.gradient, None, None


def measure(device, around, rings, size, frames):
    where = "cuda" if torch.cuda.is_available() and device.lower() != "lavapipe" else "cpu"
    wait = torch.cuda.synchronize if where == "cuda" else (lambda: None)
    program = dressi.compile(HERE / "cases/table4.dr", device=device, defines={"size": size})
    position, face = sphere(around, rings)
    goal = position * np.float32([1.03, 0.97, 1]) + np.float32([0.01, 0, 0])
    native = program.bind(position=position, face=face, goal=goal, rate=1e-6)
    target = torch.tensor(np.array(program.bind(position=goal, face=face, goal=goal, rate=0).step("look")["mask"]), device=where)
    silhouette = dressi.torch.function(program, "look", ["position"], ["mask"], constants={"face": face, "goal": goal})
    given = torch.tensor(position, device=where, requires_grad=True)
    mask, gradient = torch.zeros(size, size, device=where), torch.zeros_like(given)

    def adam(tensor):
        return torch.optim.Adam([tensor], lr=1e-6, **({"fused": True} if where == "cuda" else {}))

    def loop(call):
        tensor = given.detach().clone().requires_grad_()
        optimizer = adam(tensor)

        def frame():
            optimizer.zero_grad(set_to_none=True)
            loss = (call(tensor) - target).square().mean()
            loss.backward()
            optimizer.step()

        def timed(count):
            wait()
            start, cpu = time.perf_counter(), time.process_time()
            for _ in range(count):
                frame()
            wait()
            return (time.perf_counter() - start) / count * 1e6

        timed(20)
        return timed

    def native_frames(count):
        start = time.perf_counter()
        native.step("frame", times=count, outputs=[])
        return (time.perf_counter() - start) / count * 1e6

    # The same gradient by both roads.
    silhouette(given).sub(target).square().mean().backward()
    found = native.step("look", outputs=["gradient"])["gradient"]
    apart = np.linalg.norm(given.grad.cpu().numpy() - np.asarray(found)) / np.linalg.norm(found)
    roads = {"native": native_frames, "torch": loop(silhouette), "empty": loop(lambda t: Empty.apply(t, mask, gradient))}
    native_frames(200)
    turns = {name: [] for name in roads}
    for _ in range(5):
        for name, road in roads.items():
            turns[name].append(road(frames))
    us = {name: round(statistics.median(values), 1) for name, values in turns.items()}
    over = round(us["torch"] - us["native"] - us["empty"], 1)
    return {
        "triangles": len(face), "size": size, **us, "over native and empty": over,
        "times 938 us": round(938 / us["torch"], 2), "gradients apart": float(apart), "device": native.device.name,
    }  # fmt: skip


def main():
    device = sys.argv[1] if len(sys.argv) > 1 else "lavapipe"
    frames = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    for around, rings in ((31, 12), (96, 75), (209, 124)):
        for size in (256, 1024):
            print(json.dumps(measure(device, around, rings, size, frames)), flush=True)


main()
