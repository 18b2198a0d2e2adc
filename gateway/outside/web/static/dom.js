// What is to be on the screen, as data, and the screen changed to it node by node: focus, scroll and drawings stay.
const bare = (_, value) => (value && typeof value === "object" && !Array.isArray(value) ? Object.setPrototypeOf(value, null) : value);

// What the gateway says, as data. Its objects have no prototype: a tag may be called "constructor", and is looked up.
export const parse = (text) => JSON.parse(text, bare);

const start = parse(document.getElementById("start").textContent);
export const language = start.language;
export { start };

const SVG = "http://www.w3.org/2000/svg";

// The text of a key, with its parts in their places.
export function say(key, parts = {}) {
  const text = start.texts[key];
  if (text === undefined) return key;
  return text.replace(/\{(\w+)\}/g, (_, name) => parts[name] ?? "");
}

// What is to be on the screen, as data: a node is made of it only where none like it is there.
const shape = (svg) => (tag, attributes, ...children) =>
  ({ tag, svg, attributes: attributes || {}, children: children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false) });
export const h = shape(false);
export const s = shape(true);

export const fact = (label, ...what) => h("div", { class: "fact" }, h("dt", {}, label), h("dd", {}, what));

// The name of a figure, which says what it means to whoever opens it: by the mouse, a finger or the keyboard.
export const explained = (name, help = name.split(".")[1]) => h("details", { class: "help" }, h("summary", {}, say(name)), h("p", {}, say(`help.${help}`)));

// A table; on a phone each row of it is a list, with what a figure is beside it.
const headText = (head) => (typeof head === "string" ? head : head.children[0].children[0]); // of one that explains itself, its name
export const grid = (heads, rows) => h("div", { class: "scroll", tabindex: "0" }, h("table", { class: "stacks" },
  h("thead", {}, h("tr", {}, heads.map((text) => h("th", { scope: "col" }, text)))),
  h("tbody", {}, rows.map((cells) => h("tr", {}, cells.map((cell, place) =>
    h(place ? "td" : "th", { scope: place ? null : "row", "data-head": headText(heads[place]) }, cell)))))));

const isShape = (part) => part !== null && typeof part === "object" && !(part instanceof Node);
// An attribute's text; null for one that is not there.
const written = (value) => (value === true ? "" : value === false || value === null || value === undefined ? null : String(value));

// The node of a shape, of a text or a number; a node is one already.
export function make(part) {
  if (!isShape(part)) return part instanceof Node ? part : document.createTextNode(String(part));
  const node = part.svg ? document.createElementNS(SVG, part.tag) : document.createElement(part.tag);
  for (const [name, value] of Object.entries(part.attributes)) {
    const text = written(value);
    if (text !== null) node.setAttribute(name, text);
  }
  node.append(...part.children.map(make));
  return node;
}

const keyOf = (part) => (isShape(part) ? written(part.attributes["data-key"]) ?? undefined : undefined);
const like = (node, part) => (isShape(part) ? node.localName === part.tag && node.dataset.key === keyOf(part) : node.nodeType === Node.TEXT_NODE);

// Make a node like what is `wanted`. What bears data-keep is drawn by somebody else and stays as long as its key does.
export function morph(node, wanted) {
  if (!like(node, wanted)) {
    node.replaceWith(make(wanted));
    return;
  }
  if (!isShape(wanted)) {
    if (node.data !== String(wanted)) node.data = wanted;
    return;
  }
  const { attributes } = wanted, keep = "data-keep" in attributes;
  for (const { name } of [...node.attributes]) {
    if (!keep && name !== "open" && written(attributes[name]) === null) node.removeAttribute(name);
  }
  for (const [name, value] of Object.entries(attributes)) {
    const text = written(value);
    // What a person has opened or shut stays so.
    if (text !== null && name !== "open" && node.getAttribute(name) !== text) node.setAttribute(name, text);
  }
  // What a person has set since is the element's own, and no attribute of it.
  if (node instanceof HTMLInputElement && node.type === "checkbox") node.checked = Boolean(attributes.checked);
  if (node instanceof HTMLOptionElement) node.selected = Boolean(attributes.selected);
  if (keep) return;
  morphChildren(node, wanted.children);
}

// A row that has a key is found again wherever it goes: what is typed, opened or scrolled in it stays.
function morphChildren(node, wanted) {
  const keys = new Set(wanted.map(keyOf)), keyed = new Map();
  for (const child of [...node.children]) {
    const { key } = child.dataset;
    if (key === undefined) continue;
    if (keys.has(key)) keyed.set(key, child);
    else child.remove();
  }
  let at = node.firstChild;
  for (const part of wanted) {
    const key = keyOf(part), there = key === undefined ? at : keyed.get(key);
    if (!there || !like(there, part)) node.insertBefore(make(part), at);
    else {
      if (there === at) at = at.nextSibling;
      else node.insertBefore(there, at);
      keyed.delete(key);
      morph(there, part);
    }
  }
  while (at) {
    const over = at;
    at = at.nextSibling;
    over.remove();
  }
}

// ---------------------------------------------------------------- numbers, times

// To make one is dear, and a page writes a hundred numbers a second.
const formats = [];
export function number(value, digits = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return (formats[digits] ??= new Intl.NumberFormat(language, { minimumFractionDigits: digits, maximumFractionDigits: digits, useGrouping: false })).format(value);
}
export function shown(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return say(value ? "word.yes" : "word.no");
  if (typeof value !== "number") return String(value);
  return Number.isInteger(value) ? String(value) : number(value, Math.abs(value) < 10 ? 2 : 1);
}
export const unit = (text) => (text || "").replace("degC", "°C");
// Who did something: a name, and the address that it was done from.
export const byWhom = (who) => {
  const found = /^(.*) at (\S+)$/.exec(who ?? "");
  return found ? say("word.by_at", { name: found[1], place: found[2] }) : who;
};
// A figure and its unit, which no line's end parts.
export const withUnit = (figure, of) => (of ? `${figure}\u00a0${of}` : figure);
export function duration(seconds) {
  // What is to come, by a clock that was set back, has no age.
  if (seconds === null || seconds === undefined || seconds < 0) return "–";
  if (seconds < 120) return withUnit(number(seconds, seconds < 10 ? 1 : 0), "s");
  if (seconds < 7200) return withUnit(number(seconds / 60, 0), "min");
  return seconds < 172800 ? withUnit(number(seconds / 3600, 1), "h") : withUnit(number(seconds / 86400, 1), "d");
}
export function bytes(count) {
  if (count === null || count === undefined) return "–";
  const steps = ["B", "kB", "MB", "GB", "TB"];
  let place = 0;
  while (count >= 1000 && place < steps.length - 1) [count, place] = [count / 1000, place + 1];
  return withUnit(number(count, place ? 1 : 0), steps[place]);
}
// English as plants write it: days before months, twenty-four hours.
const places = language === "en" ? "en-GB" : language;
const two = { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" };
const times = (options) => {
  const format = new Intl.DateTimeFormat(places, options);
  return (time) => format.format(time * 1000);
};
export const clock = times(two);
export const day = times({ day: "2-digit", month: "2-digit" });
export const moment = times({ year: "numeric", month: "2-digit", day: "2-digit", ...two });

// ---------------------------------------------------------------- asking

export let person = { name: null, role: null, token: null };
export function setPerson(found) {
  person = found;
}

// The answer of the REST interface; an Error with its sentence where it refuses.
export async function ask(method, path, given = null) {
  const url = new URL(path, location.href);
  const options = { method, headers: {} };
  if (method === "GET") for (const [key, value] of Object.entries(given || {})) url.searchParams.set(key, value);
  else if (given !== null) {
    options.headers["content-type"] = "application/json";
    options.body = JSON.stringify(given);
  }
  if (method !== "GET" && person.token) options.headers["x-csrf-token"] = person.token;
  let response, answered;
  try {
    response = await fetch(url, options);
    answered = parse(await response.text());
  } catch {
    throw new Error(say("live.cut"));
  }
  if (!response.ok) {
    const error = new Error(answered.reason || response.statusText);
    error.status = response.status;
    throw error;
  }
  return answered;
}
