"""Flowchart of the page on choosing a method."""

import matplotlib.pyplot as plt
from common import save

QUESTION = {"boxstyle": "round,pad=0.45", "facecolor": "#e8eef7", "edgecolor": "#1f3b63"}
ANSWER = {"boxstyle": "square,pad=0.45", "facecolor": "#fdf3e1", "edgecolor": "#b36b00"}

#: Column, row, text, kind of each box.
BOXES = {
    "source": (0, 4, "Does turbulence or an AO loop\nchange the wavefront\nfrom image to image?", QUESTION),
    "piston": (0, 3, "Can a segment be more than\nhalf a wavelength off?", QUESTION),
    "known": (0, 2, "Is the defocus known\nto better than 1 %?", QUESTION),
    "one": (0, 1, "one defocused image or more,\nmethod \"modal\"", ANSWER),
    "colours": (1, 3, "two wavelengths\n(channels)", ANSWER),
    "pair": (1, 2, "± pair, fit_optics = [\"defocus\"]\n(channels)", ANSWER),
    "telemetry": (2, 4, "Are slopes of the wavefront\nsensor recorded?", QUESTION),
    "full": (3, 4, "\"full-phase\" with\ntelemetry, 25 to 75 images", ANSWER),
    "loop": (2, 3, "Is the loop known\n(control, sensor, mirror)?", QUESTION),
    "loops": (3, 3, "\"full-phase\",\nao_knowledge = \"loop\"", ANSWER),
    "spectrum": (2, 2, "\"full-phase\", \"spectrum\":\nNCPA with wide error bars", ANSWER),
}
#: From, to, label.
ARROWS = [
    ("source", "piston", "no"),
    ("source", "telemetry", "yes"),
    ("piston", "known", "no"),
    ("piston", "colours", "yes"),
    ("known", "one", "yes"),
    ("known", "pair", "no"),
    ("telemetry", "full", "yes"),
    ("telemetry", "loop", "no"),
    ("loop", "loops", "yes"),
    ("loop", "spectrum", "no"),
]


def place(name):
    column, row, *_ = BOXES[name]
    return 2.9 * column, 1.35 * row


def main():
    figure, axis = plt.subplots(figsize=(11, 5))
    boxes = {}
    for name, (_, _, words, kind) in BOXES.items():
        boxes[name] = axis.text(*place(name), words, ha="center", va="center", fontsize=9, bbox=kind, zorder=2)
    for start, end, label in ARROWS:
        (x0, y0), (x1, y1) = place(start), place(end)
        patches = {"patchA": boxes[start].get_bbox_patch(), "patchB": boxes[end].get_bbox_patch()}
        axis.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "->", "shrinkA": 3, "shrinkB": 3, **patches})
        figure.canvas.draw()
        if y0 == y1:
            axis.text((x0 + x1) / 2 + 0.05, y0 + 0.12, label, ha="center", fontsize=9)
        else:
            axis.text(x0 + 0.1, (y0 + y1) / 2, label, va="center", fontsize=9)
    axis.set_xlim(-1.4, 10)
    axis.set_ylim(0.8, 6)
    axis.axis("off")
    figure.subplots_adjust(0, 0, 1, 1)
    save(figure, "choosing.png", colours=64)


if __name__ == "__main__":
    main()
