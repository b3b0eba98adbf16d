// The page's state that is worth a link: view and selection, in the part of the address after "#". Pure.

export const VIEWS = ["graph", "list", "timeline", "configuration"];

/** "#/graph/function/camera/explain" as { view, kind, name, tab }. */
export function readAddress(hash, fallback = "graph") {
  const [view, kind, name, tab] = hash.replace(/^#\/?/, "").split("/").map(decode);
  return {
    view: VIEWS.includes(view) ? view : fallback,
    kind: name ? kind : "",
    name: name ?? "",
    tab: tab ?? "",
  };
}

export function writeAddress({ view, kind = "", name = "", tab = "" }) {
  const parts = [view, ...(kind && name ? [kind, name, tab] : [])].filter(Boolean);
  return `#/${parts.map(encodeURIComponent).join("/")}`;
}

function decode(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}
