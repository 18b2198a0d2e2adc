// Any tags over any time: what was measured, gaps as gaps, and beside it what had been said before.
import { ask, byWhom, duration, h, make, moment, number, s, say, unit } from "./dom.js";
import { state } from "./live.js";
import { chart, COLOURS, FAN, faint, GRID, INK, LIMIT, measuredSeries, withLimit } from "./draw.js";
import { can } from "./records.js";

const SPANS = [["90 d", 7776000], ["7 d", 604800], ["1 d", 86400], ["6 h", 21600], ["1 h", 3600], ["10 min", 600], ["1 min", 60]];
// What went before is laid over what is shown: so many seconds before it.
const EARLIER = [["1 h", 3600], ["1 d", 86400], ["7 d", 604800]];
const LEAST_SPAN_S = 1, MOST_TAGS = 8;
// How a stretch is changed, by buttons and by keys: by a quarter of itself, or to half or twice of it about its middle.
const MOVES = { earlier_on: ["←", "ArrowLeft"], later_on: ["→", "ArrowRight"], closer: ["+", "+"], wider: ["−", "-"] };
const now = (machine) => state.machines[machine].status.time;
const again = () => dispatchEvent(new HashChangeEvent("hashchange"));

// What is looked at: `range` the stretch that was chosen, `stretch` the one that is shown, until now where none was,
// `past` those that were zoomed out of, `at` the moment in it that was pointed at.
const look = { machine: null, tags: [], span: 3600, range: null, stretch: null, past: [], horizon: "", earlier: "", at: null, asked: "", data: null, error: "" };
let drawn = null; // the chart that is there
// Of one of the signals that are shown: a unit has a scale of its own.
const scaleOf = (at) => `y${[...new Set(look.data.units)].indexOf(look.data.units[at])}`;

export function trendsView([wanted]) {
  const machine = look.machine && state.machines[look.machine] ? look.machine : (look.machine = wanted && state.machines[wanted] ? wanted : state.order[0]);
  const { status, labels } = state.machines[machine];
  const names = Object.keys(status.values).filter((name) => typeof status.values[name].value !== "string");
  look.tags = look.tags.filter((tag) => names.includes(tag));
  if (!look.tags.length) look.tags = [status.temperature];
  const horizons = status.forecast?.horizons ?? [];
  const step = Math.max(look.span / 100, 2), until = Math.ceil(now(machine) / step) * step;
  look.stretch = look.range ?? [until - look.span, until];
  if (look.at < look.stretch[0] || look.at > look.stretch[1]) look.at = null;
  const parts = h("section", { class: "view trends" },
    h("div", { class: "controls" },
      h("label", {}, h("span", {}, say("word.machine")), h("select", { id: "trend-machine" }, state.order.map((name) => h("option", { value: name, selected: name === machine }, state.machines[name].label)))),
      h("div", { class: "spans", role: "group", "aria-label": say("trend.span") }, SPANS.map(([label, seconds]) => h("button", { "data-act": "span", "data-span": seconds, "aria-pressed": String(!look.range && look.span === seconds) }, label))),
      h("div", { class: "spans", role: "group", "aria-label": say("trend.move") }, Object.entries(MOVES).map(([move, [sign]]) => h("button", { "data-act": "move", "data-move": move, title: say(`trend.${move}`), "aria-label": say(`trend.${move}`) }, sign)),
        h("button", { "data-act": "back", disabled: !look.past.length }, say("trend.back"))),
      h("label", {}, h("span", {}, say("trend.compare")), h("select", { id: "trend-earlier" }, h("option", { value: "" }, "–"),
        EARLIER.map(([label, seconds]) => h("option", { value: seconds, selected: String(seconds) === look.earlier }, say("trend.earlier", { age: label }))))),
      horizons.length > 0 && h("label", {}, h("span", {}, say("trend.forecasts")), h("select", { id: "trend-horizon" }, h("option", { value: "" }, "–"),
        h("option", { value: "made", selected: look.horizon === "made" }, say("trend.of_moment")),
        horizons.map((each) => h("option", { value: each, selected: String(each) === look.horizon }, say("trend.said_before", { minutes: number(each / 60, 0) }))))),
      look.data && h("div", { class: "spans", role: "group", "aria-label": say("trend.file") }, h("button", { "data-act": "picture" }, say("trend.picture")), h("button", { "data-act": "vector" }, say("trend.vector")),
        h("a", { class: "button", href: `/api/table.csv?${new URLSearchParams({ machine, tags: look.tags.join("\n"), start: look.data.start, end: look.data.end })}`, download: "trend.csv" }, say("trend.table")))),
    h("details", { class: "tags", open: innerWidth > 700 }, h("summary", {}, say("trend.signals")), h("div", { class: "several" }, names.map((name) =>
      h("label", {}, h("input", { type: "checkbox", value: name, "data-tag": name, checked: look.tags.includes(name) }),
        h("span", {}, labels[name] ?? name, status.values[name].unit && ` (${unit(status.values[name].unit)})`, labels[name] && h("small", {}, name)))))),
    h("p", { class: look.error ? "error" : "quiet" }, look.error || `${say("trend.hint")} ${look.data ? say("trend.resolution", { width: look.data.width ? duration(look.data.width) : say("trend.readings") }) : ""}`,
      look.data?.made && h("b", {}, ` ${say("trend.made", { time: moment(look.data.made) })}`)),
    h("div", { class: "chart", id: "trend", "data-keep": "", "data-key": "trend", tabindex: "0", role: "group", "aria-label": say("nav.trends") }),
    notesOf(machine));
  return [parts, () => fetchOnce(machine, status)];
}

// What people have noted of the stretch that is shown, each with the number that it has on the time axis.
function notesOf(machine) {
  const notes = look.data?.notes ?? [];
  return h("section", { class: "notes" },
    can("operator") && h("p", { class: "buttons" }, h("button", { "data-act": "note", "data-machine": machine, "data-at": look.at }, look.at === null ? say("note.write") : say("note.about", { time: moment(look.at) }))),
    look.data?.leftOut > 0 && h("p", { class: "quiet" }, say("shift.left_out", { count: look.data.leftOut })),
    notes.length > 0 && h("ol", {}, notes.map((note, place) => h("li", {}, h("b", {}, `${place + 1}`), " ", h("time", {}, moment(note.time)), ` ${note.text} `, h("small", {}, byWhom(note.by))))));
}
addEventListener("noted", () => (look.asked = ""));

addEventListener("change", (event) => {
  const { target } = event;
  if (target.id === "trend-machine") Object.assign(look, { machine: target.value, tags: [], past: [], range: null, at: null, data: null, error: "" });
  else if (target.id === "trend-horizon") look.horizon = target.value;
  else if (target.id === "trend-earlier") look.earlier = target.value;
  else if (target.dataset?.tag) look.tags = target.checked ? [...new Set([...look.tags, target.value])].slice(-MOST_TAGS) : look.tags.filter((tag) => tag !== target.value);
  else return;
  again();
});
addEventListener("click", (event) => {
  const button = event.target.closest("[data-act=span], [data-act=back], [data-act=move], [data-act=picture], [data-act=vector]");
  if (!button) return;
  const { act, span, move } = button.dataset;
  if (act === "picture") savePicture();
  else if (act === "vector") saveVector();
  else if (act === "move") changeStretch(move);
  else if (act === "back") look.range = look.past.pop() ?? null;
  else Object.assign(look, { span: Number(span), range: null, past: [] });
  again();
});
addEventListener("keydown", (event) => {
  if (event.target.id !== "trend" || event.ctrlKey || event.altKey || event.metaKey) return;
  const move = Object.keys(MOVES).find((each) => MOVES[each][1] === event.key);
  if (!move || !look.data) return;
  event.preventDefault();
  // With the shift key the moment that is pointed at is moved, else the stretch.
  if (event.shiftKey && event.key.startsWith("Arrow")) point((move === "later_on" ? 1 : -1) / 50);
  else changeStretch(move);
  again();
});

function show(start, end) {
  look.past.push(look.range);
  look.range = [start, Math.max(end, start + LEAST_SPAN_S)];
}

function changeStretch(move) {
  // Of several in a row each goes on from the one before, whatever has been drawn by then.
  const [start, end] = look.range ?? look.stretch, span = end - start;
  if (move === "earlier_on" || move === "later_on") {
    const by = (move === "later_on" ? 1 : -1) * span / 4;
    show(start + by, end + by);
  } else {
    const half = move === "closer" ? span / 4 : span;
    show((start + end) / 2 - half, (start + end) / 2 + half);
  }
}

// Point at a moment by a share of the stretch beside the last one, with its numbers in the legend.
function point(by) {
  const [start, end] = look.range ?? look.stretch;
  look.at = Math.min(Math.max((look.at ?? end) + by * (end - start), start), end);
  drawn?.setCursor({ left: drawn.valToPos(look.at, "x"), top: drawn.over.clientHeight / 2 });
}

// Ask for what is looked at; what goes on until now is asked again as time passes, by a hundredth of the span.
function fetchOnce(machine, status) {
  const [start, end] = look.stretch;
  const ofMoment = look.horizon === "made", at = ofMoment ? Math.min(look.at ?? end, now(machine)) : null;
  const key = JSON.stringify([machine, look.tags, start, end, look.horizon, look.earlier, ofMoment && look.at]);
  const place = document.getElementById("trend");
  if (!place || !window.uPlot) return;
  if (look.asked === key) {
    if (!place.firstChild && look.data) draw(place);
    return;
  }
  look.asked = key;
  const limits = Object.fromEntries(state.machines[machine].temperatures.map((row) => [row.tag, row.limit]));
  const followed = [status.temperature, ...status.further.map((one) => one.temperature)];
  const shift = Number(look.earlier), shown = look.tags.length;
  const asks = look.tags.map((tag) => ask("GET", "/api/trend", { machine, tag, start, end }));
  if (shift) asks.push(...look.tags.map((tag) => ask("GET", "/api/trend", { machine, tag, start: start - shift, end: end - shift })));
  const temperature = look.horizon && look.tags.find((tag) => followed.includes(tag));
  if (temperature) asks.push(ofMoment ? ask("GET", "/api/forecast", { machine, temperature, at }) : ask("GET", "/api/forecasts", { machine, temperature, horizon: look.horizon, start, end }));
  Promise.all(asks).then((all) => {
    if (look.asked !== key) return;
    look.error = "";
    const { labels } = state.machines[machine], last = temperature ? all.at(-1) : null;
    // The newest forecast before a moment may be one of long before: of that nothing would be seen.
    const said = last?.made && !(last.times.at(-1) >= start) ? null : last;
    look.data = {
      width: all[0].width, start, end, notes: [], trends: all.slice(0, shown), shift, earlier: shift ? all.slice(shown, 2 * shown) : [],
      tags: look.tags.map((tag) => (labels[tag] ? `${labels[tag]} (${tag})` : tag)), units: look.tags.map((tag) => unit(status.values[tag].unit)),
      limits: look.tags.map((tag) => limits[tag]), said, saidOf: look.tags.indexOf(temperature), made: said?.made ?? null, title: state.machines[machine].label,
    };
    draw(document.getElementById("trend") ?? place);
    // After what nobody waits longer for because of them.
    ask("GET", "/api/notes", { machine, start, end }).then(({ notes, left_out: leftOut }) => {
      if (look.asked !== key || !notes.length) return;
      Object.assign(look.data, { notes, leftOut });
      draw(document.getElementById("trend") ?? place);
    }, () => {});
  }, (error) => (look.error = error.message));
}

const usualStep = ({ width, times }) => width || times.slice(1).map((time, place) => time - times[place]).sort((a, b) => a - b)[(times.length - 1) >> 1] || 0;

function draw(place) {
  const { trends, tags, units, limits, said, saidOf, notes, shift, earlier, start } = look.data;
  const tables = [], series = [], bands = [], steps = [0];
  // A unit has an axis of its own; on a narrow screen the first two alone, so that there is room for the lines.
  const kinds = [...new Set(units)];
  const add = (seen, columns, at, ...lines) => {
    tables.push([seen.times, ...columns]);
    for (const line of lines) {
      series.push({ ...line, scale: scaleOf(at) });
      steps.push(usualStep(seen));
    }
  };
  trends.forEach((seen, at) => {
    const colour = COLOURS[at % COLOURS.length], line = measuredSeries(tags[at], colour);
    if (!seen.width) return add(seen, [seen.mean], at, line);
    // The mean comes last, so that its line lies on its band.
    add(seen, [seen.low, seen.high, seen.mean], at, { ...faint(`${tags[at]} min`, colour), width: 0 }, { ...faint(`${tags[at]} max`, colour), width: 0 }, line);
    bands.push({ series: [series.length - 1, series.length - 2], fill: `${colour}30` });
  });
  earlier.forEach((seen, at) => {
    const label = EARLIER.find(([, seconds]) => seconds === shift)[0];
    add({ ...seen, times: seen.times.map((time) => time + shift) }, [seen.mean], at,
      { ...measuredSeries(`${tags[at]}, ${say("trend.earlier", { age: label })}`, COLOURS[at % COLOURS.length]), width: 1, dash: [3, 3] });
  });
  if (said?.times.length) {
    const label = said.made ? say("trend.of_moment") : say("trend.said_before", { minutes: number(said.horizon / 60, 0) });
    add(said, [said.low, said.high, said.mean], saidOf, faint("5 %", FAN), faint("95 %", FAN), { ...measuredSeries(label, FAN), dash: [6, 4] });
    bands.push({ series: [series.length - 1, series.length - 2], fill: `${FAN}33` });
  }
  const seen = { start, end: said?.made ? Math.max(look.data.end, said.times.at(-1)) : look.data.end };
  // A null that stands for a gap is kept as one; a time that only another column has is none (uPlot's modes 2 and 1).
  const data = uPlot.join(tables, tables.map((table) => table.map((_, column) => (column ? 2 : 0))));
  const scales = Object.fromEntries(kinds.map((kind, at) => [`y${at}`, { range: (_, low, high) => (low === null ? [null, null]
    : uPlot.rangeNum(low, limits.reduce((most, limit, tag) => (units[tag] === kind && limit !== undefined ? withLimit(low, most, limit) : most), high), 0.1, true)) }]));
  drawn = chart(place, {
    height: 360, series, bands,
    axes: kinds.slice(0, place.clientWidth < 700 ? 2 : 4).map((kind, at) => ({ scale: `y${at}`, side: at ? 1 : 3, label: kind, labelSize: kind ? 18 : 0, labelFont: "12px system-ui", grid: { show: !at } })),
    scales: { ...scales, x: { time: true, range: () => [seen.start, seen.end] } },
    cursor: { drag: { x: true, y: false, setScale: false }, dataIdx: (u, line, at) => nearest(u.data, line, at, steps[line] / 2) },
    hooks: { draw: [(u) => drawLimits(u, limits), (u) => drawNotes(u, notes)], ready: [pointOut, (u) => byTouch(u, seen)], setSelect: [(u) => {
      if (u.select.width < 8) return;
      show(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
      u.setSelect({ width: 0, height: 0 }, false);
      again();
    }] },
  }, data);
}

// Two lines share no time to the last digit: the reading of a line under the pointer is its nearest within half a step.
function nearest([times, ...lines], line, at, reach) {
  const values = line ? lines[line - 1] : times, from = times[at];
  let found = at, space = Infinity;
  for (const by of [-1, 1]) {
    for (let place = at; place >= 0 && place < times.length && Math.abs(times[place] - from) <= reach; place += by) {
      if (values[place] === null || values[place] === undefined) continue;
      if (Math.abs(times[place] - from) < space) [found, space] = [place, Math.abs(times[place] - from)];
      break;
    }
  }
  return found;
}

// A click that is no drag points at a moment, of which a note may be written.
function pointOut(u) {
  let from = 0;
  u.over.addEventListener("mousedown", (event) => (from = event.clientX));
  u.over.addEventListener("click", (event) => {
    if (Math.abs(event.clientX - from) >= 8) return;
    look.at = u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x");
    again();
  });
}

// One finger reads the numbers under it, two move and stretch the time between them.
function byTouch(u, seen) {
  let held = null;
  const places = (event) => [...event.touches].map((touch) => touch.clientX - u.over.getBoundingClientRect().left);
  const options = { passive: false };
  u.over.addEventListener("touchstart", (event) => (held = event.touches.length === 2 ? places(event).map((place) => u.posToVal(place, "x")) : null), options);
  u.over.addEventListener("touchmove", (event) => {
    const [one, other] = places(event);
    if (other === undefined) u.setCursor({ left: one, top: u.over.clientHeight / 2 });
    else if (held && Math.abs(one - other) > 8) {
      event.preventDefault();
      const perPixel = Math.abs((held[1] - held[0]) / (other - one));
      seen.start = held[0] - one * perPixel;
      seen.end = seen.start + u.over.clientWidth * perPixel;
      u.setScale("x", { min: seen.start, max: seen.end });
    }
  }, options);
  u.over.addEventListener("touchend", () => {
    if (!held) return;
    held = null;
    show(seen.start, seen.end);
    again();
  });
}

// What is drawn with its title, its stretch of time and its lines' names, as a file.
function savePicture() {
  if (!drawn) return;
  const plot = drawn.ctx.canvas, dots = devicePixelRatio, row = 18 * dots, names = drawn.series.slice(1).filter((line) => line.width !== 0);
  const sheet = document.createElement("canvas"), ink = sheet.getContext("2d"), edge = 12 * dots;
  Object.assign(sheet, { width: plot.width, height: plot.height + row * (names.length + 3) });
  ink.fillStyle = getComputedStyle(document.getElementById("trend")).backgroundColor;
  ink.fillRect(0, 0, sheet.width, sheet.height);
  ink.drawImage(plot, 0, 2 * row);
  Object.assign(ink, { fillStyle: INK, font: `${12 * dots}px system-ui`, textBaseline: "top" });
  ink.fillText(`${look.data.title}  ${moment(look.data.start)} – ${moment(look.data.end)}`, edge, row / 2);
  names.forEach((line, place) => {
    const top = 2 * row + plot.height + place * row;
    ink.fillStyle = line.stroke();
    ink.fillRect(edge, top + row / 3, 2 * edge, 2 * dots);
    ink.fillStyle = INK;
    ink.fillText(line.label, 4 * edge, top);
  });
  sheet.toBlob((blob) => saveFile(blob, "trend.png"));
}

function saveFile(blob, name) {
  const address = URL.createObjectURL(blob);
  make(h("a", { href: address, download: name })).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
}

// The same as lines and words that an editor can change, in the colours of the page.
function saveVector() {
  if (!drawn) return;
  const dots = devicePixelRatio, row = 18, [left, top, width, height] = ["left", "top", "width", "height"].map((each) => drawn.bbox[each] / dots);
  const [times, ...columns] = drawn.data, head = 2 * row, lines = drawn.series.slice(1), foot = head + drawn.height;
  const x = (time) => (left + drawn.valToPos(time, "x")).toFixed(1), y = (value, scale) => (head + top + drawn.valToPos(value, scale)).toFixed(1);
  const text = (at, high, said, more = {}) => s("text", { x: at, y: high, fill: INK, ...more }, said);
  const points = (column) => times.map((time, place) => [time, columns[column][place]]).filter(([, value]) => value !== undefined);
  const path = (column) => points(column).map(([time, value], place, all) => (value === null ? "" : `${place && all[place - 1][1] !== null ? "L" : "M"}${x(time)} ${y(value, lines[column].scale)}`)).join("");
  // A band ends where its lines do: it has a polygon for each stretch. Its opacity is told apart, which editors ask for.
  const band = ({ series: [high, low], fill }) => {
    const stretches = [[]], colour = fill(drawn);
    times.forEach((time, place) => {
      const ends = [high, low].map((line) => columns[line - 1][place]);
      if (ends.includes(null)) stretches.push([]);
      else if (!ends.includes(undefined)) stretches.at(-1).push(ends.map((value) => `${x(time)},${y(value, lines[high - 1].scale)}`));
    });
    return stretches.filter(({ length }) => length > 1).map((rows) => s("polygon", {
      points: [...rows.map(([top]) => top), ...rows.map(([, bottom]) => bottom).reverse()].join(" "), fill: colour.slice(0, 7), "fill-opacity": (parseInt(colour.slice(7), 16) / 255).toFixed(2) }));
  };
  const [, ...scales] = drawn.axes, named = lines.filter((line) => line.width);
  const limits = look.data.limits.map((limit, at) => limit !== undefined && s("g", {}, s("line", { x1: left, x2: left + width, y1: y(limit, scaleOf(at)), y2: y(limit, scaleOf(at)), stroke: LIMIT, "stroke-dasharray": "3 3" }),
    text(left + 4, y(limit, scaleOf(at)) - 3, `${say("word.limit")} ${number(limit)}`, { fill: LIMIT })));
  const sheet = make(s("svg", { xmlns: "http://www.w3.org/2000/svg", width: drawn.width, height: foot + row * (named.length + 1), "font-family": "sans-serif", "font-size": 12 },
    s("rect", { width: "100%", height: "100%", fill: getComputedStyle(document.getElementById("trend")).backgroundColor }), s("clipPath", { id: "plot" }, s("rect", { x: left, y: head + top, width, height })),
    text(12, row, `${look.data.title}  ${moment(look.data.start)} – ${moment(look.data.end)}`),
    drawn.axes[0]._splits.map((time, place) => [s("line", { x1: x(time), x2: x(time), y1: head + top, y2: head + top + height, stroke: GRID }), text(x(time), head + top + height + row, drawn.axes[0]._values[place], { "text-anchor": "middle" })]),
    scales.map(({ _splits: splits, _values: values, scale, side, label }) => splits?.map((value, place) => text(side === 3 ? left - 6 : left + width + 6, Number(y(value, scale)) + 4, `${values[place]}${place === splits.length - 1 ? ` ${label ?? ""}` : ""}`, { "text-anchor": side === 3 ? "end" : "start" }))),
    s("g", { "clip-path": "url(#plot)" }, drawn.bands.map(band), limits,
      lines.map((line, column) => line.width > 0 && s("path", { d: path(column), fill: "none", stroke: line.stroke(), "stroke-width": line.width, "stroke-dasharray": line.dash?.join(" ") })),
      look.data.notes.map((note, place) => s("g", {}, s("line", { x1: x(note.time), x2: x(note.time), y1: head + top, y2: head + top + height, stroke: INK }), text(Number(x(note.time)) + 3, head + top + 12, `${place + 1}`)))),
    s("rect", { x: left, y: head + top, width, height, fill: "none", stroke: GRID }),
    named.map((line, place) => [s("rect", { x: 12, y: foot + place * row + 5, width: 24, height: 2, fill: line.stroke() }), text(44, foot + place * row + 10, line.label)])));
  saveFile(new Blob([new XMLSerializer().serializeToString(sheet)], { type: "image/svg+xml" }), "trend.svg");
}

// The limit of each temperature, where it lies in the picture.
function drawLimits(u, limits) {
  const { ctx, bbox } = u, dots = devicePixelRatio;
  ctx.save();
  Object.assign(ctx, { strokeStyle: LIMIT, fillStyle: LIMIT, lineWidth: dots, font: `${12 * dots}px system-ui`, textAlign: "left", textBaseline: "bottom" });
  ctx.setLineDash([3 * dots, 3 * dots]);
  [...new Set(limits)].forEach((limit) => {
    if (limit === undefined) return;
    const y = Math.round(u.valToPos(limit, scaleOf(limits.indexOf(limit)), true));
    if (!(y >= bbox.top && y <= bbox.top + bbox.height)) return;
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.fillText(`${say("word.limit")} ${number(limit)}`, bbox.left + 4 * dots, y - 2 * dots);
  });
  ctx.restore();
}

// A line with its number for each note, in the order of the list below.
function drawNotes({ ctx, bbox, valToPos }, notes) {
  ctx.save();
  Object.assign(ctx, { strokeStyle: INK, fillStyle: INK, font: `${12 * devicePixelRatio}px system-ui`, textAlign: "left", textBaseline: "top" });
  notes.forEach((note, place) => {
    const x = Math.round(valToPos(note.time, "x", true));
    ctx.fillRect(x, bbox.top, devicePixelRatio, bbox.height);
    ctx.fillText(`${place + 1}`, x + 3 * devicePixelRatio, bbox.top + 2);
  });
  ctx.restore();
}
