// Elements from data, and what is on the screen changed to them node by node: focus, scroll and drawings stay.
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

function build(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (value === true) node.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(name, value);
  }
  for (const child of children.flat(3)) {
    if (child === null || child === undefined || child === false) continue;
    node.append(child instanceof Node ? child : String(child));
  }
  return node;
}
export const h = (tag, attributes, ...children) => build(document.createElement(tag), attributes, children);
export const s = (tag, attributes, ...children) => build(document.createElementNS(SVG, tag), attributes, children);

// Make `old` like `fresh`. What bears data-keep is drawn by somebody else and stays as long as its key does.
export function morph(old, fresh) {
  if (old.nodeType !== fresh.nodeType || old.nodeName !== fresh.nodeName || old.dataset?.key !== fresh.dataset?.key) {
    old.replaceWith(fresh);
    return;
  }
  if (old.nodeType === Node.TEXT_NODE) {
    if (old.data !== fresh.data) old.data = fresh.data;
    return;
  }
  for (const { name } of [...old.attributes]) {
    if (!fresh.hasAttribute(name) && name !== "open" && !("keep" in (old.dataset || {}))) old.removeAttribute(name);
  }
  for (const { name, value } of fresh.attributes) {
    // What a person has opened or shut stays so.
    if (name !== "open" && old.getAttribute(name) !== value) old.setAttribute(name, value);
  }
  // What a person has set since is the element's own, and no attribute of it.
  if (old instanceof HTMLInputElement && old.type === "checkbox") old.checked = fresh.checked;
  if (old instanceof HTMLOptionElement) old.selected = fresh.selected;
  if (old.dataset && "keep" in old.dataset) return;
  const before = [...old.childNodes], after = [...fresh.childNodes];
  after.forEach((child, place) => (place < before.length ? morph(before[place], child) : old.append(child)));
  before.slice(after.length).forEach((child) => child.remove());
}

// ---------------------------------------------------------------- numbers, times

export function number(value, digits = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return new Intl.NumberFormat(language, { minimumFractionDigits: digits, maximumFractionDigits: digits, useGrouping: false }).format(value);
}
export function shown(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return say(value ? "word.yes" : "word.no");
  if (typeof value !== "number") return String(value);
  return Number.isInteger(value) ? String(value) : number(value, Math.abs(value) < 10 ? 2 : 1);
}
export const unit = (text) => (text || "").replace("degC", "°C");
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 120) return `${number(seconds, seconds < 10 ? 1 : 0)} s`;
  if (seconds < 7200) return `${number(seconds / 60, 0)} min`;
  return seconds < 172800 ? `${number(seconds / 3600, 1)} h` : `${number(seconds / 86400, 1)} d`;
}
export function bytes(count) {
  if (count === null || count === undefined) return "–";
  const steps = ["B", "kB", "MB", "GB", "TB"];
  let place = 0;
  while (count >= 1000 && place < steps.length - 1) [count, place] = [count / 1000, place + 1];
  return `${number(count, place ? 1 : 0)} ${steps[place]}`;
}
// English as plants write it: days before months, twenty-four hours.
const places = language === "en" ? "en-GB" : language;
const two = { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" };
export const clock = (time) => new Date(time * 1000).toLocaleTimeString(places, two);
export const day = (time) => new Date(time * 1000).toLocaleDateString(places, { day: "2-digit", month: "2-digit" });
export const moment = (time) =>
  new Date(time * 1000).toLocaleString(places, { year: "numeric", month: "2-digit", day: "2-digit", ...two });

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
