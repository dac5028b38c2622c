"""Resistor networks solved node by node, with ideal sources and no impedance matrix; nothing of it is lampest's."""

from collections.abc import Hashable, Iterable

import numpy as np

Node = Hashable
Resistor = tuple[Node, Node, float]


def potentials(resistors: Iterable[Resistor], held: dict[Node, float]) -> dict[Node, float]:
    """Node → volt, for nodes that sources hold at a potential; resistors of 0 ohm join their nodes."""
    resistors = list(resistors)
    joined = {node: node for one, other, _ in resistors for node in (one, other)}
    for one, other, ohm in resistors:
        if ohm == 0:
            # What is held stays: the other node takes its name.
            keep, lose = (one, other) if joined[one] in held else (other, one)
            lost = joined[lose]
            joined = {node: joined[keep] if name == lost else name for node, name in joined.items()}
    free = [node for node in dict.fromkeys(joined.values()) if node not in held]
    number = {node: index for index, node in enumerate(free)}
    matrix, current = np.zeros((len(free),) * 2), np.zeros(len(free))
    for one, other, ohm in resistors:
        for here, there in ((joined[one], joined[other]), (joined[other], joined[one])):
            if ohm == 0 or here not in number:
                continue
            matrix[number[here], number[here]] += 1 / ohm
            if there in number:
                matrix[number[here], number[there]] -= 1 / ohm
            else:
                current[number[here]] += held[there] / ohm
    volt = np.linalg.solve(matrix, current)
    return {node: held[name] if name in held else float(volt[number[name]]) for node, name in joined.items()}
