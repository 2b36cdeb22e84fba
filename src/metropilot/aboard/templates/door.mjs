// @NAME@ under protection, in WebAssembly: `import { load } from "./@NAME@.mjs"`.
//
//     const driver = await load(bytes);            // of @NAME@.wasm, as an ArrayBuffer
//     driver.reset(0);
//     const answer = driver.step({ time_s, position_m, speed_mps, acceleration_mps2, scheduled_s });
//
// SI units. A measurement that is lost is NaN. One call of step or supervise in every control period.

export const PERIOD_S = @PERIOD@;
export const TRAINSET = "@TRAINSET@";
export const SECTIONS = [
@JS_SECTIONS@
];
export const LEVELS = ["none", "traction cut off", "service brake", "emergency brake"];

/** A driver and the plant of the example, from the bytes of the WebAssembly module. */
export async function load(bytes) {
  const { instance } = await WebAssembly.instantiate(bytes, {});
  const c = instance.exports;
  c._initialize?.();
  const measure = (m) => c.measure(m.time_s, m.position_m, m.speed_mps, m.acceleration_mps2, m.scheduled_s);
  const answer = () => ({
    share: c.share(), emergency: c.emergency() !== 0, level: c.level(), permitted_mps: c.permitted_mps(),
  });
  return {
    /** State at departure, of driver and plant. */
    reset(section) {
      if (c.reset(section) !== 0) throw new RangeError(`section: ${section}, allowed 0 to ${SECTIONS.length - 1}`);
    },
    /** One control period: the driver decides, protection has the last word. */
    step(measured) { measure(measured); c.step(); return answer(); },
    /** One control period by hand: protection alone, on a command from -1 to 1. */
    supervise(measured, share, emergency = false) {
      measure(measured); c.supervise(share, emergency ? 1 : 0); return answer();
    },
    /** The plant follows the last answer for one period. */
    move() { c.move(); },
    /** Measurements of the plant; the scheduled running time is the caller's. */
    plant() {
      return {
        time_s: c.time_s(), position_m: c.position_m(), speed_mps: c.speed_mps(),
        acceleration_mps2: c.acceleration_mps2(), traction_j: c.traction_j(),
      };
    },
    /** Times that protection has intervened since departure. */
    interventions() { return c.interventions(); },
    /** Permitted speed at a place, m/s. */
    permitted(section, position_m) { return c.permitted(section, position_m); },
  };
}
