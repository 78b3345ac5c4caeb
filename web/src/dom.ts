/** Small helpers for the elements of the page. */

export function by<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

export function made<K extends keyof HTMLElementTagNameMap>(name: K, text = ""): HTMLElementTagNameMap[K] {
  const found = document.createElement(name);
  found.textContent = text;
  return found;
}

/** Set a property only if it changes: the browser draws again even when the new value equals the old one. */
export function put<T, K extends keyof T>(at: T, name: K, value: T[K]): void {
  if (at[name] !== value) at[name] = value;
}

/** Set an attribute only if it changes, as ``put`` does with a property. */
export function change(at: Element, name: string, value: string): void {
  if (at.getAttribute(name) !== value) at.setAttribute(name, value);
}

/** Set the text of an element, if it changes. */
export function tell(id: string, text: string): void {
  put(by(id), "textContent", text);
}

/** A button that is enabled while the panel allows a command. */
export function button(text: string, what: string, press: () => void): HTMLButtonElement {
  const found = made("button", text);
  found.type = "button";
  found.dataset.what = what;
  found.onclick = press;
  return found;
}

export function value(id: string): string {
  return by<HTMLInputElement>(id).value.trim();
}

/** Whether the focus is in a text field, where a space is a character. */
export function writing(): boolean {
  const at = document.activeElement;
  return (
    at instanceof HTMLTextAreaElement ||
    (at instanceof HTMLInputElement && !["button", "checkbox", "file", "radio", "range"].includes(at.type))
  );
}

/** Whether the focus is in a field or list that takes keys. */
export function typing(): boolean {
  const at = document.activeElement;
  return (
    writing() || at instanceof HTMLSelectElement || (at instanceof HTMLInputElement && at.type === "range")
  );
}

/** Scroll to a place whose top is below the lower quarter of the window, as on a phone. */
export function intoSight(place: HTMLElement): void {
  const { top } = place.getBoundingClientRect();
  if (place.offsetParent === null || top < 0.75 * window.innerHeight) return;
  const header = document.querySelector("header")!.getBoundingClientRect();
  window.scrollBy({ top: top - header.bottom - 8 });
}

let refuse = () => {};

/** Ask a question in the page: a dialog of the browser would take the keys that stop the machine. */
export function asked(text: string, yes: string): Promise<boolean> {
  refuse(); // the earlier question, if it was not answered
  return new Promise((answer) => {
    const say = (agreed: boolean) => {
      put(by("ask-row"), "hidden", true);
      refuse = () => {};
      answer(agreed);
    };
    refuse = () => say(false);
    tell("ask-text", text);
    tell("ask-yes", yes);
    by("ask-yes").onclick = () => say(true);
    by("ask-no").onclick = () => say(false);
    put(by("ask-row"), "hidden", false);
  });
}
