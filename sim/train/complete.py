"""The completion branch of core/net/README.md 2.14, with its norms folded."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

INPUTS, OUTPUTS = 15, 3
WIDTH = (32, 48, 64, 96, 128, 128)
STAY = (0, 1, 1, 2, 1, 2)


class Complete(nn.Module):
    """(B, 15, h, w) to (B, 3, h, w). Its state dict is that of the checkpoint without the prefix
    "complete."."""

    def __init__(self):
        super().__init__()
        ends = zip((INPUTS, *WIDTH), WIDTH)
        self.down = nn.ModuleList(
            nn.Conv2d(a, b, 3, 2 if l else 1, 1) for l, (a, b) in enumerate(ends)
        )
        self.stay = nn.ModuleList(
            nn.ModuleList(nn.Conv2d(c, c, 3, 1, 1) for _ in range(n)) for c, n in zip(WIDTH, STAY)
        )
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in zip(WIDTH, WIDTH[1:]))
        self.join = nn.ModuleList(nn.Conv2d(c, c, 3, 1, 1) for c in WIDTH[:-1])
        self.out = nn.Conv2d(WIDTH[0], OUTPUTS, 3, 1, 1)

    def forward(self, x: Tensor) -> Tensor:
        levels = []
        for down, stay in zip(self.down, self.stay):
            x = down(x).relu()
            for conv in stay:
                x = x + conv(x).relu()
            levels.append(x)
        for l in reversed(range(len(self.up))):
            x = F.interpolate(self.up[l](x), levels[l].shape[-2:], mode="bilinear")
            x = self.join[l](x + levels[l]).relu()
        return self.out(x)
