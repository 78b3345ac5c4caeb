/** What drawing costs here, and whether anybody would see it. */

const NO_CARD = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Whether the browser says that the processor draws what is in three dimensions, as without a graphics card it does. */
export function bySoftware(): boolean {
  const probe = document.createElement("canvas").getContext("webgl2", { antialias: false });
  if (!probe) return false;
  const told = probe.getExtension("WEBGL_debug_renderer_info");
  const name = String(probe.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : probe.RENDERER));
  probe.getExtension("WEBGL_lose_context")?.loseContext();
  return NO_CARD.test(name);
}

/** A way to ask whether a place is on the screen: in the part of the page that is open, and not scrolled away. */
export function onScreen(place: Element): () => boolean {
  let seen = false;
  new IntersectionObserver((changes) => { seen = changes[changes.length - 1]!.isIntersecting; }).observe(place);
  return () => seen;
}
