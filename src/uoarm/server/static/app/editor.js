// An editor for the configuration, and two texts side by side. CodeMirror stands in a shadow root: the page allows no
// style of its own making, and a shadow root takes styles as objects.

import { useEffect, useRef } from "../vendor/htm-preact.js";
import * as cm from "../vendor/codemirror.js";
import { html } from "./ui.js";
import { explainAt, offersAt } from "./yaml.js";

const NARROW = 760; // pixels: below, two texts are shown as one

const LOOK = cm.EditorView.theme({
  "&": { color: "var(--ink)", backgroundColor: "var(--sunk)", fontSize: "13px", border: "1px solid var(--strong-line)", borderRadius: "8px" },
  "&.cm-focused": { outline: "2px solid var(--accent)" },
  ".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "1.5", maxHeight: "60vh", overflow: "auto" },
  ".cm-content": { caretColor: "var(--ink)" },
  ".cm-cursor": { borderLeftColor: "var(--ink)" },
  ".cm-gutters": { color: "var(--soft)", backgroundColor: "var(--raised)", borderRight: "1px solid var(--line)" },
  ".cm-activeLine, .cm-activeLineGutter": { backgroundColor: "var(--accent-soft)" },
  "&.cm-focused .cm-selectionBackground, .cm-selectionBackground": { backgroundColor: "color-mix(in srgb, var(--accent) 30%, transparent) !important" },
  ".cm-tooltip": { color: "var(--ink)", backgroundColor: "var(--raised)", border: "1px solid var(--strong-line)", borderRadius: "6px", maxWidth: "420px" },
  ".cm-tooltip .explained": { padding: "6px 10px", whiteSpace: "pre-wrap" },
  ".cm-tooltip-autocomplete ul li[aria-selected]": { color: "var(--on-accent)", backgroundColor: "var(--accent)" },
  ".cm-diagnostic": { whiteSpace: "pre-wrap" },
  ".cm-changedLine": { backgroundColor: "color-mix(in srgb, var(--ok) 14%, transparent) !important" },
  ".cm-merge-a .cm-changedLine, .cm-deletedChunk": { backgroundColor: "color-mix(in srgb, var(--bad) 14%, transparent) !important" },
});
const COLOURS = cm.HighlightStyle.define([
  { tag: [cm.tags.propertyName, cm.tags.definition(cm.tags.propertyName)], color: "var(--accent)" },
  { tag: cm.tags.comment, color: "var(--soft)", fontStyle: "italic" },
  { tag: [cm.tags.string, cm.tags.content], color: "var(--ink)" },
]);
const SHOWN = [cm.lineNumbers(), cm.yaml(), cm.syntaxHighlighting(COLOURS), LOOK];
const named = (label) => cm.EditorView.contentAttributes.of({ "aria-label": label, tabindex: "0" });
const READ_ONLY = [...SHOWN, cm.EditorState.readOnly.of(true)];

/** Args: a source, whose text takes the place of what is there, change(text), problems by line, the schema. Tab leaves it: Ctrl+] indents. */
export function TextEditor({ source, change, problems, schema, label }) {
  const host = useRef(null);
  const view = useRef(null);
  const given = useRef({});
  given.current = { change, schema };
  useEffect(() => {
    const root = host.current.shadowRoot ?? host.current.attachShadow({ mode: "open" });
    const complete = (context) => complementsAt(context, given.current.schema);
    const explain = (shown, at) => explainedAt(shown, at, given.current.schema);
    const extensions = [...SHOWN, cm.lintGutter(), cm.history(), cm.drawSelection(), cm.highlightActiveLine(), cm.highlightActiveLineGutter(),
      cm.bracketMatching(), cm.highlightSelectionMatches(), cm.search({ top: true }), cm.autocompletion({ override: [complete] }), cm.hoverTooltip(explain),
      cm.keymap.of([...cm.completionKeymap, ...cm.defaultKeymap, ...cm.historyKeymap, ...cm.searchKeymap]), named(label),
      cm.EditorView.updateListener.of((update) => update.docChanged && given.current.change(update.state.doc.toString()))];
    view.current = new cm.EditorView({ state: cm.EditorState.create({ doc: source.text, extensions }), parent: root, root });
    return () => view.current.destroy();
  }, []);
  useEffect(() => {
    const { state } = view.current;
    if (state.doc.toString() !== source.text) view.current.dispatch({ changes: { from: 0, to: state.doc.length, insert: source.text } });
  }, [source]);
  useEffect(() => {
    const { state } = view.current;
    view.current.dispatch(cm.setDiagnostics(state, problems.map((problem) => diagnosticOf(problem, state.doc))));
  }, [problems]);
  return html`<div class="editor" ref=${host}></div>`;
}

function diagnosticOf({ line, column, text }, doc) {
  const { from, to } = doc.line(Math.min(Math.max(1, line), doc.lines));
  return { from: Math.min(to, from + column - 1), to, severity: "error", message: text };
}

function complementsAt(context, schema) {
  const text = context.state.doc.toString();
  if (!schema) return null;
  const { from, offers } = offersAt(schema, text, context.pos);
  if (offers.length === 0 || (from === context.pos && !context.explicit)) return null;
  const options = offers.map(({ label, detail, info, isKey }) =>
    ({ label, detail, info: info || undefined, type: isKey ? "property" : "constant", apply: isKey ? `${label}: ` : label }));
  return { from, options, validFor: /^[\w.-]*$/ };
}

function explainedAt(view, at, schema) {
  const word = view.state.wordAt(at);
  const text = schema && word ? explainAt(schema, view.state.doc.toString(), word.from) : "";
  if (!text) return null;
  const create = () => {
    const dom = document.createElement("div");
    dom.className = "explained";
    dom.textContent = text;
    return { dom };
  };
  return { pos: word.from, end: word.to, create };
}

/** What is in force and what is to be, side by side; in one where there is no room for two. */
export function Difference({ before, after }) {
  const host = useRef(null);
  useEffect(() => {
    const root = host.current.shadowRoot ?? host.current.attachShadow({ mode: "open" });
    const collapseUnchanged = { margin: 3, minSize: 6 };
    if (host.current.clientWidth < NARROW) {
      const merge = cm.unifiedMergeView({ original: before, mergeControls: false, collapseUnchanged });
      const state = cm.EditorState.create({ doc: after, extensions: [...READ_ONLY, named("What changes"), merge] });
      const view = new cm.EditorView({ state, parent: root, root });
      return () => view.destroy();
    }
    const view = new cm.MergeView({ parent: root, root, collapseUnchanged, gutter: true,
      a: { doc: before, extensions: [...READ_ONLY, named("In force")] }, b: { doc: after, extensions: [...READ_ONLY, named("To be applied")] } });
    return () => view.destroy();
  }, [before, after]);
  return html`<div class="difference" ref=${host}></div>`;
}
