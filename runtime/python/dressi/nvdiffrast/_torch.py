# SPDX-License-Identifier: Apache-2.0
"""The operations as nodes of PyTorch's graph."""
from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..torch import differentiable_once


class Node(torch.autograd.Function):
    """`operation` takes a dict of arrays, and gives results and the way back: from seeds to gradients by name."""

    @staticmethod
    def forward(ctx: Any, operation: Any, names: list[str], *tensors: Any) -> Any:
        # Of what is no tensor a copy: nobody would notice that it was written to.
        arrays = {
            name: t.detach().cpu().numpy() if isinstance(t, torch.Tensor) else None if t is None else np.array(t)
            for name, t in zip(names, tensors)
        }
        results, ctx.back = operation(arrays)
        ctx.names = names
        like = next(t for t in tensors if isinstance(t, torch.Tensor))
        # Kept so that what was written to since is noticed.
        ctx.save_for_backward(*(t for t in tensors if isinstance(t, torch.Tensor)))
        ctx.is_tensor = [isinstance(t, torch.Tensor) for t in tensors]
        return tuple(torch.from_numpy(result).to(like.device) for result in results)

    @staticmethod
    def backward(ctx: Any, *seeds: Any) -> Any:
        saved = iter(ctx.saved_tensors)
        with torch.no_grad():
            gradients = ctx.back([None if s is None else s.detach().cpu().numpy() for s in seeds])
        out: list[Any] = []
        for name, is_tensor in zip(ctx.names, ctx.is_tensor):
            if not is_tensor:
                out.append(None)
                continue
            tensor, found = next(saved), gradients.get(name)
            out.append(None if found is None else torch.from_numpy(found.copy()).to(tensor.device, tensor.dtype))
        return (None, None, *differentiable_once(out, [*ctx.saved_tensors, *seeds]))
