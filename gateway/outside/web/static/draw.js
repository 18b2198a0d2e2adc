// Pictures of what was and what may come: the small ones of a row, and the large ones (uPlot).
import { ask, clock, day, h, moment, number, s, say } from "./dom.js";
import { state } from "./live.js";

// ---------------------------------------------------------------- what was measured lately

const HISTORY_S = 1200;
const kept = new Map(); // "machine tag" -> {times, values, asked}

// The newest readings of a temperature: those of the records once, then each picture's.
export function recent(machine, tag) {
  const key = `${machine} ${tag}`;
  const picture = state.machines[machine];
  if (!kept.has(key)) {
    const rows = { times: [], values: [] };
    kept.set(key, rows);
    const end = picture.status.time;
    ask("GET", "/api/trend", { machine, tag, start: end - HISTORY_S * picture.status.speed, end })
      .then((seen) => {
        const first = rows.times[0] ?? Infinity;
        const older = seen.times.map((time, place) => [time, seen.mean[place]]).filter(([time]) => time < first);
        rows.times.unshift(...older.map(([time]) => time));
        rows.values.unshift(...older.map(([, value]) => value));
      })
      .catch(() => {}); // without records the line begins now
  }
  const rows = kept.get(key);
  const reading = picture.status.values[tag];
  // A clock that was set back: what it said of later moments is not what will be.
  while (rows.times.at(-1) > picture.status.time) rows.times.pop(), rows.values.pop();
  if (reading && reading.time <= picture.status.time && reading.time > (rows.times.at(-1) ?? -Infinity)) {
    rows.times.push(reading.time);
    rows.values.push(reading.quality === "GOOD" ? reading.value : null);
    const oldest = reading.time - HISTORY_S * picture.status.speed;
    while (rows.times[0] < oldest) {
      rows.times.shift();
      rows.values.shift();
    }
  }
  return rows;
}

// How high a picture reaches: to the limit where it is near; far above it would make every line flat.
export const withLimit = (low, high, limit) => (limit < high + 2 * Math.max(high - low, 5) ? Math.max(high, limit) : high);

const LEVELS = [0.05, 0.25, 0.5, 0.75, 0.95];

// The fan as points: from the newest reading on, one of `levels` quantiles at each horizon; [] where none is usable.
export function fan(forecast, value) {
  if (!forecast || !forecast.usable || value === null) return [];
  const places = LEVELS.map((level) => forecast.levels.indexOf(level));
  if (places.includes(-1)) return [];
  const points = [{ time: forecast.time, q: LEVELS.map(() => value) }];
  forecast.horizons.forEach((horizon, place) => {
    points.push({ time: forecast.time + horizon, q: places.map((each) => forecast.quantiles[place][each]) });
  });
  return points;
}

// A row's picture: what was, the fan, the limit; the words beside it say the same.
export function sparkline(machine, row, forecast, speed) {
  const width = 260, height = 64, rows = recent(machine, row.tag);
  const points = fan(forecast, row.value);
  const now = state.machines[machine].status.time;
  const from = now - 900 * speed;
  const to = points.length ? points.at(-1).time : now + 60 * speed;
  const line = rows.times.map((time, place) => [time, rows.values[place]]).filter(([time]) => time >= from);
  const numbers = [...line.map(([, value]) => value), ...points.flatMap((point) => point.q)].filter((v) => v !== null);
  if (!numbers.length) return h("div", { class: "spark none" });
  let low = Math.min(...numbers), high = Math.max(...numbers);
  high = withLimit(low, high, row.limit);
  const space = Math.max((high - low) * 0.12, 0.5);
  [low, high] = [low - space, high + space];
  const x = (time) => (((time - from) / (to - from)) * width).toFixed(1);
  const y = (value) => (height - ((value - low) / (high - low)) * height).toFixed(1);
  const band = (a, b) =>
    [...points.map((p) => `${x(p.time)},${y(p.q[a])}`), ...points.map((p) => `${x(p.time)},${y(p.q[b])}`).reverse()].join(" ");
  let path = "", pen = false;
  for (const [time, value] of line) {
    if (value === null) pen = false;
    else {
      path += `${pen ? "L" : "M"}${x(time)} ${y(value)}`;
      pen = true;
    }
  }
  return s("svg", { class: "spark", viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none", "aria-hidden": "true" },
    row.limit <= high && s("line", { class: "limit", x1: 0, x2: width, y1: y(row.limit), y2: y(row.limit) }),
    points.length > 0 && s("polygon", { class: "fan outer", points: band(0, 4) }),
    points.length > 0 && s("polygon", { class: "fan inner", points: band(1, 3) }),
    points.length > 0 && s("polyline", { class: "median", points: points.map((p) => `${x(p.time)},${y(p.q[2])}`).join(" ") }),
    s("path", { class: "was", d: path }),
    s("line", { class: "now", x1: x(now), x2: x(now), y1: 0, y2: height }),
  );
}

// ---------------------------------------------------------------- large pictures

// A canvas takes no variables of the style sheet: the page's own are looked up once, light or dark.
const styled = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const [INK, GRID, LIMIT] = ["--axis", "--grid", "--limit"].map(styled);
export const FAN = styled("--fan");
export const COLOURS = matchMedia("(prefers-color-scheme: dark)").matches
  ? ["#8ec1e0", "#d8b46c", "#a5c98f", "#c9a6dd", "#86c4c4", "#dba093", "#b9c3ca", "#d9c24a"]
  : ["#24506e", "#7a5a1e", "#4c6b3c", "#6b4580", "#3f6f70", "#7d4a3f", "#555f66", "#8a6d00"];

const axis = (extra) => ({ stroke: INK, grid: { stroke: GRID, width: 1 }, ticks: { stroke: GRID }, font: "12px system-ui", ...extra });

// uPlot in `place`, as wide as it; gives the chart.
export function chart(place, { series, bands = [], height = 300, hooks = {}, scales = {}, axes = [{}], cursor = {} }, data) {
  const options = {
    width: Math.max(place.clientWidth, 240),
    height,
    series: [{ value: (_, time) => (time === null ? "–" : moment(time)), label: say("word.time") }, ...series],
    bands,
    scales: { x: { time: true }, ...scales },
    axes: [
      axis({ values: (u, ticks) => ticks.map((tick) => label(tick, u.scales.x.max - u.scales.x.min)), space: 70 }),
      ...axes.map((own) => axis({ size: 52, values: (_, ticks) => ticks.map((tick) => number(tick, Number.isInteger(tick) ? 0 : 1)), ...own })),
    ],
    cursor: { drag: { x: true, y: false }, ...cursor },
    legend: { live: true },
    hooks,
  };
  place.replaceChildren();
  const made = new uPlot(options, data, place);
  new ResizeObserver(() => {
    const width = Math.max(place.clientWidth, 240);
    if (place.isConnected && Math.abs(width - made.width) > 1) made.setSize({ width, height });
  }).observe(place);
  return made;
}
function label(time, span) {
  if (span > 3 * 86400) return day(time);
  return span > 1200 ? clock(time).slice(0, 5) : clock(time);
}

export const measuredSeries = (name, colour = INK) => ({ label: name, stroke: colour, width: 1.6, points: { show: false }, value: (_, v) => number(v, 2) });
export const faint = (name, colour) => ({ label: name, stroke: colour, width: 0.6, points: { show: false }, value: (_, v) => number(v, 2) });

// The machine's picture: readings of the last twenty minutes, the fan ahead, the limit.
const fans = new WeakMap();
export function fanChart(place, machine, row, forecast) {
  const rows = recent(machine, row.tag), points = fan(forecast, row.value);
  // A newer reading is drawn once it lies a pixel beside the last one: what is new within it nobody sees.
  const last = fans.get(place), first = rows.times[0], read = rows.times.at(-1);
  // Without a forecast the picture reaches until now: a line that ended at its edge would be read as a present one.
  const newest = points.length ? read : Math.max(read ?? -Infinity, state.machines[machine].status.time);
  const pixel = last && ((points.at(-1)?.time ?? newest) - first) / last.made.width;
  const key = [rows.values.at(-1) === null, row.limit, points[0]?.time].join();
  if (last?.key === key && Math.abs(newest - last.newest) < pixel && first >= last.first) return;
  const ahead = points.length ? points.slice(1) : newest > read ? [{ time: newest, q: LEVELS.map(() => null) }] : [];
  const times = [...rows.times, ...ahead.map((p) => p.time)];
  const line = [...rows.values, ...ahead.map(() => null)];
  const blank = rows.times.map(() => null);
  if (points.length && blank.length) blank[blank.length - 1] = rows.values.at(-1);
  const quantile = (which) => [...blank, ...ahead.map((p) => p.q[which])];
  const limit = times.map(() => row.limit);
  const data = [times, line, quantile(0), quantile(1), quantile(2), quantile(3), quantile(4), limit];
  let made = last?.made;
  if (!made) {
    made = chart(place, {
      height: 280,
      series: [
        measuredSeries(say("word.measured")),
        faint("5 %", FAN), faint("25 %", FAN),
        { ...measuredSeries(say("word.median"), FAN), dash: [6, 4] },
        faint("75 %", FAN), faint("95 %", FAN),
        { label: say("word.limit"), stroke: LIMIT, width: 1, dash: [3, 3], points: { show: false }, value: (_, v) => number(v, 1) },
      ],
      bands: [{ series: [6, 2], fill: `${FAN}29` }, { series: [5, 3], fill: `${FAN}3d` }],
    }, data);
  } else made.setData(data);
  fans.set(place, { made, key, first, newest });
}

// The link over the last hour: what was lost is dark.
export function strip(status) {
  const width = 600, now = status.time, span = 3600 * status.speed, x = (time) => (Math.max(time - (now - span), 0) / span) * width;
  const lost = status.link.outages.map((outage) => {
    const begin = x(outage.last_good);
    const end = x(outage.recovered_s === null ? now : outage.last_good + outage.recovered_s * status.speed);
    return end > 0 && s("rect", { class: "lost", x: begin.toFixed(1), width: Math.max(end - begin, 1.5).toFixed(1), y: 0, height: 14 });
  });
  return s("svg", { class: "strip", viewBox: `0 0 ${width} 14`, preserveAspectRatio: "none", "aria-hidden": "true" },
    s("rect", { class: "held", x: 0, y: 0, width, height: 14 }), lost);
}
