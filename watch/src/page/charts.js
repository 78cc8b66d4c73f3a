// Pictures of the page: mirror, maps, curves. Text goes in by textContent alone.

const NAMESPACE = "http://www.w3.org/2000/svg";

export function element(name, attributes = {}, text) {
  const made = document.createElementNS(NAMESPACE, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

// Blue for negative, red for positive values of -1 to 1, white between.
export function diverging(value) {
  const t = Math.max(-1, Math.min(1, value));
  const mix = (end) => end.map((c, i) => Math.round(247 + (c - 247) * Math.abs(t) ** 0.8));
  return t < 0 ? mix([33, 102, 172]) : mix([178, 24, 43]);
}

const css = (colour) => `rgb(${colour.join(",")})`;

// Direction from a segment to its nearest neighbour: its hexagon has an edge across it.
function direction(segments) {
  const [x, y] = segments[0].centre_m;
  let best = [Infinity, 0];
  for (const { centre_m: [u, v] } of segments.slice(1)) {
    const distance = Math.hypot(u - x, v - y);
    if (distance < best[0]) best = [distance, Math.atan2(v - y, u - x)];
  }
  return best[1];
}

// The mirror as a picture; y is up. Gives the scale, nm.
export function drawMirror(place, mirror, selected, select) {
  const segments = mirror.segments.filter((segment) => segment.centre_m);
  if (segments.length === 0) {
    place.replaceChildren();
    return null;
  }
  const value = (segment) => segment.tracked_nm ?? segment.piston_nm;
  const scale = Math.max(1, ...segments.map((segment) => Math.abs(value(segment) ?? 0)));
  const inner = mirror.inner_radius_m, outer = (inner * 2) / Math.sqrt(3), turn = direction(segments) + Math.PI / 6;
  const reach = Math.max(...segments.map(({ centre_m: [x, y] }) => Math.hypot(x, y))) + outer * 1.02;
  const unit = 200 / reach;
  const svg = element("svg", { viewBox: "-202 -202 404 404", role: "group", "aria-label": "Mirror" });
  for (const segment of segments) {
    const [x, y] = segment.centre_m.map((m) => m * unit);
    const corner = (k) => [x + outer * unit * 0.98 * Math.cos(turn + (k * Math.PI) / 3), -y - outer * unit * 0.98 * Math.sin(turn + (k * Math.PI) / 3)];
    const points = [0, 1, 2, 3, 4, 5].map((k) => corner(k).map((c) => c.toFixed(1)).join(",")).join(" ");
    const nm = value(segment), known = nm !== null && nm !== undefined;
    const colour = known ? diverging(nm / scale) : [160, 160, 160];
    const label = `segment ${segment.label}: ${known ? `${nm.toFixed(1)} nm` : "no value"}`;
    const polygon = element("polygon", { points, class: "segment", fill: css(colour), tabindex: 0, role: "button",
      "aria-label": label, "aria-pressed": segment.segment === selected, "data-segment": segment.segment });
    polygon.append(element("title", {}, label));
    polygon.addEventListener("click", () => select(segment.segment));
    polygon.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); select(segment.segment); }
    });
    const dark = colour[0] + colour[1] + colour[2] < 400;
    svg.append(polygon, element("text", { x: x.toFixed(1), y: (-y).toFixed(1), class: "number", fill: dark ? "#fff" : "#222" }, segment.label));
  }
  // What has the focus keeps it.
  const focused = document.activeElement?.dataset?.segment;
  place.replaceChildren(svg);
  if (focused !== undefined) svg.querySelector(`[data-segment="${CSS.escape(focused)}"]`)?.focus();
  return scale;
}

// A map of rows from below on a canvas; `colour` gives three numbers for a value.
export function drawMap(canvas, rows, colour) {
  const height = rows.length, width = height ? rows[0].length : 0;
  if (!width) return;
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d"), pixels = context.createImageData(width, height);
  rows.forEach((row, y) => row.forEach((value, x) => {
    const at = ((height - 1 - y) * width + x) * 4;
    if (value === null) return;
    const [r, g, b] = colour(value);
    pixels.data.set([r, g, b, 255], at);
  }));
  context.putImageData(pixels, 0, 0);
}

export function grey(level) {
  const t = Math.max(0, Math.min(1, level));
  return [Math.round(255 * t ** 1.1), Math.round(235 * t), Math.round(60 + 160 * t)];
}

// Round numbers between two values.
function ticks(least, most, count) {
  const raw = (most - least) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const made = [];
  for (let value = Math.ceil(least / step) * step; value <= most + step * 1e-6; value += step) made.push(value);
  return made;
}

const short = (value) => (value !== 0 && (Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3) ? value.toExponential(1) : String(+value.toPrecision(6)));

// Curves over time: points with error bars, a line with its band.
export function drawCurve(place, { time, points, errors, line, band }, size = [360, 150]) {
  const [width, height] = size, [left, right, top, bottom] = [46, 8, 8, 20];
  const finite = (value) => value !== null && value !== undefined && Number.isFinite(value);
  const all = [];
  time.forEach((_, i) => {
    if (finite(points?.[i])) all.push(points[i] - (errors?.[i] ?? 0), points[i] + (errors?.[i] ?? 0));
    if (finite(line?.[i])) all.push(line[i] - (band?.[i] ?? 0), line[i] + (band?.[i] ?? 0));
  });
  if (all.length === 0) { place.replaceChildren(); return; }
  let [least, most] = [Math.min(...all), Math.max(...all)];
  if (most - least < 1e-9 * Math.max(1, Math.abs(most))) { least -= 0.5; most += 0.5; }
  const [begin, end] = [Math.min(...time), Math.max(...time)];
  const x = (t) => left + (end > begin ? (t - begin) / (end - begin) : 0.5) * (width - left - right);
  const y = (v) => top + ((most - v) / (most - least)) * (height - top - bottom);
  const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img" });
  for (const value of ticks(least, most, 4)) {
    svg.append(element("line", { class: "axis", x1: left, x2: width - right, y1: y(value).toFixed(1), y2: y(value).toFixed(1) }));
    svg.append(element("text", { class: "tick", x: left - 6, y: y(value).toFixed(1), "text-anchor": "end", "dominant-baseline": "central" }, short(value)));
  }
  const clock = (t) => new Date(t * 1000).toISOString().slice(11, 19);
  svg.append(element("text", { class: "tick", x: left, y: height - 4 }, `${clock(begin)} UTC`));
  if (end > begin) svg.append(element("text", { class: "tick", x: width - right, y: height - 4, "text-anchor": "end" }, clock(end)));
  const order = time.map((_, i) => i).sort((a, b) => time[a] - time[b]);
  const drawn = order.filter((i) => finite(line?.[i]));
  if (band && drawn.length > 1) {
    const edge = (sign) => (i) => `${x(time[i]).toFixed(1)},${y(line[i] + sign * (band[i] ?? 0)).toFixed(1)}`;
    svg.append(element("polygon", { class: "band", points: [...drawn.map(edge(1)), ...drawn.map(edge(-1)).reverse()].join(" ") }));
  }
  if (points) {
    for (const i of order.filter((i) => finite(points[i]))) {
      const at = x(time[i]).toFixed(1);
      if (errors) svg.append(element("line", { class: "bar", x1: at, x2: at, y1: y(points[i] - errors[i]).toFixed(1), y2: y(points[i] + errors[i]).toFixed(1) }));
      svg.append(element("circle", { class: "dot", cx: at, cy: y(points[i]).toFixed(1), r: drawn.length > 150 ? 1.2 : 2 }));
    }
  }
  if (drawn.length > 1) svg.append(element("polyline", { class: "line", points: drawn.map((i) => `${x(time[i]).toFixed(1)},${y(line[i]).toFixed(1)}`).join(" ") }));
  place.replaceChildren(svg);
}
