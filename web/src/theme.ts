/** Colours of the page's present theme, light or dark, for what is drawn by hand. */

/** A colour, by the name of its variable. */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** Call when the system changes between light and dark. */
export function onTheme(changed: () => void): void {
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
}
