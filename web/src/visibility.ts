/** Whether drawing is slow in this browser, and whether an element is on the screen. */

const NO_CARD = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Whether the browser draws three dimensions on the processor, without a graphics card. */
export function bySoftware(): boolean {
  const probe = document.createElement("canvas").getContext("webgl2", { antialias: false });
  if (!probe) return false;
  const told = probe.getExtension("WEBGL_debug_renderer_info");
  const name = String(probe.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : probe.RENDERER));
  probe.getExtension("WEBGL_lose_context")?.loseContext();
  return NO_CARD.test(name);
}

/** Return a function that says whether an element is on the screen: in the open part of the page, and not scrolled away. */
export function onScreen(place: Element): () => boolean {
  let seen = false;
  new IntersectionObserver((changes) => {
    seen = changes[changes.length - 1]!.isIntersecting;
  }).observe(place);
  return () => seen;
}

/** Width and height in pixels for a picture: as wide as its place, and no higher than leaves the rest in sight. */
export function sizeOf(place: HTMLElement): [number, number] {
  const width = Math.max(place.clientWidth, 200);
  return [width, Math.round(Math.max(Math.min(width * 0.6, window.innerHeight * 0.52), 240))];
}
