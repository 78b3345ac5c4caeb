/** The name of this browser for other operators: "Chrome on Linux", "Safari on iPhone". */

const BROWSERS: [RegExp, string][] = [
  [/Edg/, "Edge"],
  [/Firefox|FxiOS/, "Firefox"],
  [/Chrome|CriOS/, "Chrome"],
  [/Safari/, "Safari"],
];
const DEVICES: [RegExp, string][] = [
  [/iPhone/, "iPhone"],
  [/iPad/, "iPad"],
  [/Android.*Mobile/, "an Android phone"],
  [/Android/, "an Android tablet"],
  [/Windows/, "Windows"],
  [/Mac OS/, "a Mac"],
  [/CrOS/, "a Chromebook"],
  [/Linux/, "Linux"],
];

export function deviceName(agent: string): string {
  const named = (all: [RegExp, string][]) => all.find(([known]) => known.test(agent))?.[1];
  const [browser, device] = [named(BROWSERS) ?? "a browser", named(DEVICES)];
  return device ? `${browser} on ${device}` : browser;
}
