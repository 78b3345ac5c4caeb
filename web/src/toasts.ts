/** What is said to the operator: toasts by severity, and the list of events with its counts. */

import { by, made, put, tell } from "./dom";

const MOST_LINES = 200;
const MOST_TOASTS = 3;
const SHOWN_MS = 6_000;
const WRONG_SHOWN_MS = 20_000;

/** Add a message to the list of events, and show it for a while above every part of the page. */
export function say(text: string, wrong = false): void {
  note(text, wrong);
  toast(text, wrong);
}

/** Add a message to the list of events only. */
export function note(text: string, wrong = false): void {
  const line = made("li", `${new Date().toLocaleTimeString()}  ${text}`);
  line.className = wrong ? "wrong" : "";
  const log = by("log");
  log.prepend(line);
  while (log.childElementCount > MOST_LINES) log.lastElementChild!.remove();
  count();
}

function count(): void {
  const all = by("log").childElementCount;
  const troubles = by("log").querySelectorAll(".wrong").length;
  tell(
    "log-count",
    all === 0 ? "" : `${all} message${all === 1 ? "" : "s"}${troubles ? `, ${troubles} about trouble` : ""}`,
  );
}

function toast(text: string, wrong: boolean): void {
  const toasts = by("toasts");
  const found = made("div");
  found.className = wrong ? "wrong" : "";
  if (wrong) found.setAttribute("role", "alert");
  const close = made("button", "✕");
  close.type = "button";
  close.setAttribute("aria-label", "Close this message");
  close.onclick = () => found.remove();
  found.append(made("span", text), close);
  toasts.append(found);
  while (toasts.childElementCount > MOST_TOASTS) toasts.firstElementChild!.remove();
  setTimeout(() => found.remove(), wrong ? WRONG_SHOWN_MS : SHOWN_MS);
}

/** Let the operator look at trouble only. */
export function filterLog(): void {
  const only = by<HTMLInputElement>("log-wrong");
  only.onchange = () => put(by("log"), "className", only.checked ? "only-wrong" : "");
}
