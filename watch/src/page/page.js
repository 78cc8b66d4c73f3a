// The page: reads the JSON behind it after every change, and draws.

import { diverging, drawCurve, drawMap, drawMirror, grey } from "/charts.js";

// Between two readings: frames may come a hundred times a second.
const PAUSE_MS = 250;
const find = (id) => document.getElementById(id);
let selected = null, mirror = null, isReading = false, isAskedAgain = false;

async function read(address) {
  const answer = await fetch(address, { credentials: "same-origin" });
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return answer.json();
}

const clock = (seconds) => new Date(seconds * 1000).toISOString().slice(11, 19);
const number = (value, digits = 3) => (value === null || value === undefined ? "–" : Number(value).toPrecision(digits));

function figure(name, value) {
  const box = document.createElement("div"), list = document.createElement("dl");
  const term = document.createElement("dt"), text = document.createElement("dd");
  box.className = "figure";
  term.textContent = name;
  text.textContent = value;
  list.append(term, text);
  box.append(list);
  return box;
}

function showStatus(status) {
  find("source").textContent = `${status.source} · ${status.policy}`;
  find("problem").hidden = !status.problem;
  find("problem").textContent = status.problem ?? "";
  const last = status.last_frame;
  const newest = last && last.status === "done" ? last : null;
  find("figures").replaceChildren(
    figure("frames", String(status.counts.done)),
    figure("refused", String(status.counts.refused)),
    figure("last minute", `${status.frames_last_minute} frames`),
    figure("latency", status.latency_s === null || status.latency_s === undefined ? "–" : `${number(status.latency_s)} s`),
    figure("last frame", last ? `${clock(last.observed_s)} UTC` : "none yet"),
    figure("phasing", newest ? `${number(newest.phasing_rms_nm)} nm` : "–"),
    figure("NCPA", newest ? `${number(newest.ncpa_rms_nm)} nm` : "–"),
    figure("pointing", status.pointing_rms_pixels === null || status.pointing_rms_pixels === undefined ? "–" : `${number(status.pointing_rms_pixels)} pixels RMS`),
    figure("reduced χ²", newest ? number(newest.chi2) : "–"),
  );
}

async function showSegment() {
  if (selected === null) return;
  const found = await read(`/api/segments/${selected}?limit=300`);
  const label = mirror?.segments.find((segment) => segment.segment === selected)?.label ?? selected;
  const history = found.history, last = history[history.length - 1];
  const column = (key) => history.map((point) => point[key]);
  const tracked = last && last.tracked_nm !== null;
  find("segment-title").textContent = `Segment ${label}: piston, nm`;
  drawCurve(find("segment"), {
    time: column("time_s"), points: column("value_nm"), errors: column("sigma_nm"),
    line: tracked ? column("tracked_nm") : undefined, band: tracked ? column("tracked_sigma_nm") : undefined,
  }, [360, 240]);
  const shown = tracked ? [last.tracked_nm, last.tracked_sigma_nm, "tracked"] : last ? [last.value_nm, last.sigma_nm, "newest frame"] : null;
  find("segment-note").textContent = shown ? `${shown[0].toFixed(2)} ± ${shown[1].toFixed(2)} nm (${shown[2]}); ${history.length} frames` : "no frame yet";
}

function showMirror() {
  if (!mirror) return;
  const scale = drawMirror(find("mirror"), mirror, selected, (segment) => {
    selected = segment;
    showMirror();
    showSegment().catch(lost);
  });
  find("mirror-note").textContent = scale === null ? "This scene has no segments." :
    mirror.frame === null ? "No frame yet." : `blue to red: −${scale.toFixed(1)} to +${scale.toFixed(1)} nm`;
}

function list(place, items, none, line) {
  const made = items.map((item) => {
    const row = document.createElement("li"), time = document.createElement("time"), [seconds, text, kind] = line(item);
    time.textContent = new Date(seconds * 1000).toISOString().slice(0, 19).replace("T", " ");
    if (kind) row.className = kind;
    row.append(time, text);
    return row;
  });
  if (made.length === 0) {
    const row = document.createElement("li");
    row.className = "none";
    row.textContent = none;
    made.push(row);
  }
  place.replaceChildren(...made);
}

// What was seen of a correction.
function seen(one) {
  if (one.applied_s === null) return one.replaced_by === null ? "not yet" : `replaced by ${one.replaced_by}`;
  const part = one.applied_part === "whole" ? "" : `, ${one.applied_part} alone`;
  return `${clock(one.applied_s)}, ${(100 * one.applied_fraction).toFixed(1)} ± ${(100 * one.applied_fraction_error).toFixed(1)} %${part}`;
}

function showCorrections(corrections) {
  const rows = corrections.map((one) => {
    const row = document.createElement("tr");
    for (const text of [one.number, clock(one.written_s), one.frame, one.phasing_rms_nm.toFixed(2), one.ncpa_rms_nm.toFixed(2), seen(one)]) {
      const cell = document.createElement("td");
      cell.textContent = text;
      row.append(cell);
    }
    return row;
  });
  if (rows.length === 0) {
    const row = document.createElement("tr"), cell = document.createElement("td");
    cell.colSpan = 6;
    cell.textContent = "none";
    row.append(cell);
    rows.push(row);
  }
  find("corrections").replaceChildren(...rows);
}

function showMaps(ncpa, image) {
  const values = ncpa.nm.flat().filter((value) => value !== null);
  const scale = values.reduce((most, value) => Math.max(most, Math.abs(value)), 1e-9);
  drawMap(find("ncpa"), ncpa.nm, (nm) => diverging(nm / scale));
  find("ncpa-note").textContent = values.length ? `blue to red: −${scale.toFixed(1)} to +${scale.toFixed(1)} nm` : "No frame yet.";
  const light = image.data_e.flat().filter((value) => value !== null);
  const peak = light.reduce((most, value) => Math.max(most, value), 1e-9);
  drawMap(find("image"), image.data_e, (electrons) => grey(Math.sqrt(Math.max(0, electrons) / peak)));
  drawMap(find("residual"), image.residual_sigma, (sigma) => diverging(sigma / 5));
  find("image-note").textContent = image.frame === null ? "Shown from the next frame on." : `frame ${image.frame}, peak ${peak.toPrecision(4)} electrons`;
}

async function update() {
  const addresses = ["status", "mirror", "ncpa", "image", "trend", "events", "refused", "corrections"];
  const [status, newMirror, ncpa, image, trend, events, refused, corrections] = await Promise.all(addresses.map((name) => read(`/api/${name}`)));
  mirror = newMirror;
  showStatus(status);
  showMirror();
  await showSegment();
  showMaps(ncpa, image);
  for (const [name, key] of [["phasing", "phasing_rms_nm"], ["ncpa", "ncpa_rms_nm"], ["chi2", "reduced_chi2"], ["flux", "flux_e"],
    ["pointing-x", "pointing_x_pixels"], ["pointing-y", "pointing_y_pixels"]]) {
    drawCurve(find(`trend-${name}`), { time: trend.time_s, line: trend[key] });
  }
  const alarms = ["segment", "wavefront", "pointing", "disk"];
  list(find("events"), events.events, "none", (event) => [event.time_s, event.sentence, alarms.includes(event.kind) ? "alarm" : ""]);
  showCorrections(corrections.corrections);
  list(find("refused"), refused.refused, "none", (frame) => [frame.observed_s, `${label(frame)}: ${frame.reason}`, ""]);
  document.body.dataset.frames = status.counts.done;
}

// Which frame, and what its fit was.
function label(frame) {
  const name = frame.image > 0 ? `${frame.name} image ${frame.image}` : frame.name;
  return frame.fit ? `${name} (${frame.fit})` : name;
}

function state(name, text) {
  find("connection").dataset.state = name;
  find("connection").textContent = text;
}

function lost() {
  state("lost", "no connection");
}

// One reading at a time; a change during one asks for another.
async function refresh() {
  if (isReading) { isAskedAgain = true; return; }
  isReading = true;
  try {
    await update();
    state("open", "live");
  } catch {
    lost();
  }
  setTimeout(() => {
    isReading = false;
    if (isAskedAgain) { isAskedAgain = false; refresh(); }
  }, PAUSE_MS);
}

const changes = new EventSource("/api/changes");
changes.addEventListener("changed", refresh);
changes.addEventListener("error", lost);
