// Recordings of a function: a button that begins and ends them, and where a recording is played, its scrubber.

import { useEffect, useState } from "../vendor/htm-preact.js";
import { short, span } from "./format.js";
import { Right } from "./kill.js";
import { Facts, html, Icon, Notice } from "./ui.js";

const EVERY = 1000;
const RATES = ["0.25", "0.5", "1", "2", "4", "fast"];

/** What an operation without arguments says, again every second: { report, trouble, look }. The last report stays where one fails. */
function useReport(store, op) {
  const [state, setState] = useState({ report: null, trouble: "" });
  const [turn, setTurn] = useState(0);
  useEffect(() => {
    let over = false;
    let timer;
    const see = (seen) => over || setState(seen);
    const look = async () => {
      if (!document.hidden) {
        await store.wire.ask(op).then(
          (report) => see({ report, trouble: "" }),
          (error) => see(({ report }) => ({ report, trouble: error.message })),
        );
      }
      if (!over) timer = setTimeout(look, EVERY);
    };
    look();
    return () => {
      over = true;
      clearTimeout(timer);
    };
  }, [op, turn, store.link]);
  return { ...state, look: () => setTurn((number) => number + 1) };
}

/** Args: the store and the name of a function. */
export function Recordings({ store, name }) {
  const records = useReport(store, "Record");
  const plays = useReport(store, "Play");
  const [refusal, setRefusal] = useState("");
  const ask = async (...asked) => {
    try {
      await store.wire.ask(...asked);
      setRefusal("");
    } catch (error) {
      setRefusal(error.message);
    }
    records.look();
    plays.look();
  };
  const old = [records, plays].find(({ report, trouble }) => report && trouble);
  const its = (records.report?.recordings ?? []).filter(({ functions }) => functions.some((of) => of.split(".")[0] === name));
  const played = (plays.report?.players ?? []).filter(({ functions }) => functions.includes(name));
  return html`
    <h3>Recordings <span class="hint" role="status" title=${old?.trouble}>${old && "as last known"}</span></h3>
    ${played.map((player) => html`<${Player} key=${player.bridge} of=${player} move=${(how) => ask("Play", player.bridge, how)} />`)}
    <${Right} store=${store} operations=${["request", "record"]} name=${name} to="record it">
      <p><button type="button" class="button" onClick=${() => ask("Record", "", { functions: [name] })}><${Icon} name="record" /> Record</button></p></${Right}>
    ${refusal && html`<${Notice} kind="bad" title="Refused">${refusal}</${Notice}>`}
    <ul class="parts">${its.map((recording) => html`<${Recording} key=${recording.recording} of=${recording}
      stop=${() => ask("Record", recording.recording, { stop: true })} />`)}</ul>`;
}

const Recording = ({ of, stop }) => html`
  <li><div class="part-head"><b>${of.recording}</b><span>${of.state}</span>
      ${of.state === "recording" && of.may_stop && html`<button type="button" class="button small push" onClick=${stop}>
        <${Icon} name="stop" /> Stop recording</button>`}</div>
    <${Facts} of=${[["file", of.files.join(", ")], ["size", `${short(of.octets)} octets in ${span(of.seconds)}`], ["begun by", of.owner],
      ["recorded", short(of.channels.reduce((sum, channel) => sum + channel.recorded, 0))]]} />
    ${of.cause && html`<${Notice} kind=${of.state === "failed" ? "bad" : "info"} title="Cause">${of.cause}</${Notice}>`}</li>`;

/** Where a recording is, and what moves it. */
function Player({ of, move }) {
  const [wanted, setWanted] = useState(null); // while one drags
  const position = wanted ?? of.position;
  const seek = (event) => {
    setWanted(null);
    move({ seek: Number(event.target.value) });
  };
  const rate = of.rate === null ? "fast" : String(of.rate);
  return html`
    <div class="player">
      <p><b>${of.bridge}</b> plays ${of.file}</p>
      <input type="range" min="0" max=${of.duration} step="any" value=${position} disabled=${!of.may_move} aria-label=${`Position in ${of.file}`}
        aria-valuetext=${`${span(position)} of ${span(of.duration)}`} onInput=${(event) => setWanted(Number(event.target.value))} onChange=${seek} />
      <div class="bar">
        <button type="button" class="button small" disabled=${!of.may_move} onClick=${() => move({ pause: !of.is_paused })}>
          ${of.is_paused ? "Play" : "Pause"}</button>
        <button type="button" class="button small" disabled=${!of.may_move} onClick=${() => move({ step: true })}>Step</button>
        <label>Speed <select value=${rate} disabled=${!of.may_move} onChange=${({ target }) => move({ rate: target.value === "fast" ? "fast" : Number(target.value) })}>
          ${[...new Set([...RATES, rate])].map((speed) => html`<option value=${speed}>${speed === "fast" ? "as fast as possible" : `${speed} ×`}</option>`)}</select></label>
        <span>${span(position)} of ${span(of.duration)}</span>
      </div>
      ${of.cause && html`<${Notice} kind="warn">${of.cause}</${Notice}>`}
      ${!of.may_move && html`<p class="hint">To move it, a role needs the right <code>record</code> for each of its functions; <code>uoarm token NAME --role ROLE</code> makes a token of such a role.</p>`}
    </div>`;
}
