// A plug-in for Open MCT: a session's parameters, as an instance of YAMCS has them.

const INSTANCE = "kontur_av";
const TYPE = "yamcs.parameter";
const NAMESPACE = "yamcs";
const FOLDER = "session";
const POLL_MS = 500;
const MOST_VALUES = 1000;

/** Return the plug-in. `fetch`: as of a browser; YAMCS is asked under /api of the page's host. */
export function yamcs(fetch) {
  const ask = async (path, body) => {
    const request = body && { method: "POST", body: JSON.stringify(body) };
    const answer = await fetch(`/api/${path}`, request);
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer.json();
  };
  let parameters;
  const known = () => (parameters ??= ask(`mdb/${INSTANCE}/parameters?limit=500`).then(byName));
  return (openmct) => {
    openmct.types.addType(TYPE, { name: "Parameter", cssClass: "icon-telemetry" });
    openmct.objects.addRoot({ namespace: NAMESPACE, key: FOLDER });
    openmct.objects.addProvider(NAMESPACE, {
      get: async (identifier) => domainObject(identifier, await known()),
    });
    openmct.composition.addProvider({
      appliesTo: ({ identifier }) => identifier.namespace === NAMESPACE && identifier.key === FOLDER,
      load: async () => [...(await known()).keys()].map((key) => ({ namespace: NAMESPACE, key })),
    });
    openmct.telemetry.addProvider(history(ask, known));
    openmct.telemetry.addProvider(live(ask, known));
  };
}

function byName({ parameters = [] }) {
  // Fields of packets have capitals.
  const own = parameters.filter(
    (one) => /^\/kontur_av\/[a-z]/.test(one.qualifiedName) && one.type,
  );
  own.sort((one, other) => one.name.localeCompare(other.name));
  return new Map(own.map((one) => [one.name, one]));
}

function domainObject(identifier, parameters) {
  if (identifier.key === FOLDER) {
    return { identifier, name: "Session", type: "folder", location: "ROOT" };
  }
  const { name, type } = parameters.get(identifier.key);
  const value = { key: "value", name, unit: type.unitSet?.[0]?.unit, hints: { range: 1 } };
  if (type.enumValues) {
    value.format = "enum";
    value.enumerations = type.enumValues.map((one) => ({ value: Number(one.value), string: one.label }));
  }
  const time = { key: "utc", name: "Time", format: "utc", hints: { domain: 1 } };
  const location = `${NAMESPACE}:${FOLDER}`;
  return { identifier, name, type: TYPE, location, telemetry: { values: [time, value] } };
}

/** Return a value of YAMCS as a row of Open MCT: an enumeration by its number. */
export function row(told, type) {
  const { type: kind, ...values } = told.engValue;
  const [plain] = Object.values(values);
  const label = type.enumValues?.find((one) => one.label === plain);
  const number = /^(FLOAT|DOUBLE|[SU]INT)/.test(kind);
  const value = label ? Number(label.value) : number ? Number(plain) : plain;
  return { utc: Date.parse(told.generationTime), value };
}

function history(ask, known) {
  return {
    supportsRequest: (object) => object.type === TYPE,
    request: async ({ identifier }, { start, end }) => {
      const { name, type } = (await known()).get(identifier.key);
      const span = `start=${new Date(start).toISOString()}&stop=${new Date(end).toISOString()}`;
      const more = `order=desc&limit=${MOST_VALUES}&source=replay`;
      const path = `archive/${INSTANCE}/parameters/${INSTANCE}/${name}?${span}&${more}`;
      const { parameter = [] } = await ask(path);
      return parameter.map((told) => row(told, type)).reverse();
    },
  };
}

function live(ask, known) {
  const wanted = new Map(); // name -> callbacks
  const newest = new Map(); // name -> time of the newest value
  const poll = async () => {
    const names = [...wanted.keys()];
    if (names.length === 0) return;
    const id = names.map((name) => ({ name: `/${INSTANCE}/${name}` }));
    const path = `processors/${INSTANCE}/realtime/parameters:batchGet`;
    const { value = [] } = await ask(path, { id, fromCache: true });
    for (const told of value) {
      const name = told.id.name.split("/").pop();
      if (newest.get(name) === told.generationTime) continue;
      newest.set(name, told.generationTime);
      const found = row(told, (await known()).get(name).type);
      for (const callback of wanted.get(name) ?? []) callback(found);
    }
  };
  const again = () => poll().catch(console.warn).finally(() => setTimeout(again, POLL_MS));
  again();
  return {
    supportsSubscribe: (object) => object.type === TYPE,
    subscribe: ({ identifier: { key } }, callback) => {
      if (!wanted.has(key)) wanted.set(key, new Set());
      wanted.get(key).add(callback);
      newest.delete(key);
      return () => {
        wanted.get(key)?.delete(callback);
        if (wanted.get(key)?.size === 0) wanted.delete(key);
      };
    },
  };
}
