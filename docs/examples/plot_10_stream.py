"""
Estimate frames as they arrive
==============================

A stream takes one frame at a time and starts each solve at the frame before.
"""

import matplotlib.pyplot as plt

import lampest

recording = lampest.datasets.load("lamprey_35mm")
scene = recording.scene
frames = recording.resistance
unloaded = recording.role == lampest.UNLOADED
resting = lampest.Readings.of(scene, frames[unloaded]).mean()
stream = lampest.Stream.begin(
    lampest.Estimator((lampest.Misfit(),), formulation="reduced"), scene, 1.0, resting
)
strongest = []
for frame in frames[~unloaded]:
    stream, step = stream.push(lampest.Readings.of(scene, frame))
    strongest.append(step.solution.cell_resistance[-1].min())

figure, axes = plt.subplots()
axes.plot(recording.time[~unloaded], strongest, "o-")
axes.set(xlabel="time [s]", ylabel="smallest cell resistance [Ω]", yscale="log")
