"""The circuit of a recording: whether it explains the readings, and which other one would.

The readings of the frames that decide are fitted under the scene's circuit. Alternatives, which are
other circuits, other orders of the readings and other converters, are first judged by laws that
cost milliseconds, then by the evidence of the same frames.

| module | content |
|---|---|
| `explanation` | the frames that decide, and the cells that explain them, with their evidence |
| `loaded_density` | density of the loaded frame about its most probable cells |
| `kinds` | circuits of other kinds and settings with the same converter and resistor |
| `alternatives` | these circuits, other orders of the readings, other converters |
| `parameters` | the most probable resistance in series and memory of an alternative |
| `better_alternative` | the alternative that explains the frames better than the scene's circuit |
| `model_check` | the verdict in a sentence |
| `alike` | panels that read alike under one circuit, and the choice among them |
"""
