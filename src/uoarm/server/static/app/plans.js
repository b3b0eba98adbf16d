// Asks which plan a function has, once for each time that it is looked at.

import { useEffect, useState } from "../vendor/htm-preact.js";

/** { plan, refusal, again }: plan is null until the server answered. */
export function usePlan(store, name) {
  const [state, setState] = useState({ plan: null, refusal: null });
  const [turn, setTurn] = useState(0);
  useEffect(() => {
    let current = true;
    const show = (found) => current && setState(found);
    store.wire.ask("Resolve", name).then(
      ({ plan }) => show({ plan, refusal: null }),
      (refusal) => show({ plan: null, refusal }),
    );
    return () => {
      current = false;
    };
  }, [name, turn, store.link]);
  return { ...state, again: () => setTurn(turn + 1) };
}

export const providerOf = (plan) => plan.steps.at(-1);
