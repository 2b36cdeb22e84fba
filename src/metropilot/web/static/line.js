// A running line in the browser: the train graph grows, each piece in the colour of its train's delay.
(() => {
  const WINDOW_S = 1800, DRAW_MS = 500, LATE_S = [5, 60];
  const clock = (s) => `${Math.floor(s / 60)}:${String(Math.round(s % 60)).padStart(2, "0")}`;
  const DELAY = 3, ENERGY = 4, FLOOR = 5, NOW = 6;

  class Line extends MetropilotStream {
    on_scene(scene) {
      super.on_scene(scene);
      this.root.dataset.status = "running";
      this.set("status", metropilotSay("under way"));
      this.set("trains", scene.trains);
    }

    on_rows(said) { super.on_rows(said, DRAW_MS); }

    update(last) {
      const late = last.delay_s.filter((s) => s > LATE_S[0]), all = late.reduce((a, b) => a + b, 0);
      Object.assign(this.root.dataset, { time: last.time_s, late: late.length, delay: all });
      this.set("time", clock(last.time_s));
      this.set("late", late.length, metropilotSay("of {count}", { count: this.now.trains }));
      this.set("worst", Math.max(0, ...last.delay_s).toFixed(0), "s");
      this.set("energy", last.energy_kwh.toFixed(0), "kWh");
      this.set("gap", last.gap_percent === null ? "–" : last.gap_percent.toFixed(2), "%");
      this.set("waits", last.waits);
      this.set("stops", last.stops);
      this.draw((Plotly, el) => this.grow(Plotly, el, last));
    }

    grow(Plotly, el, last) {
      const from = last.time_s - WINDOW_S, seen = this.kept.filter((row) => row.time_s >= from);
      const paths = [0, 1, 2].map(() => ({ x: [], y: [] })), minutes = seen.map((row) => row.time_s / 60);
      for (let k = 1; k < seen.length; k++) {
        const before = seen[k - 1], row = seen[k];
        row.position_m.forEach((at, train) => {
          const s = row.delay_s[train], path = paths[s > LATE_S[1] ? 2 : s > LATE_S[0] ? 1 : 0];
          path.x.push(minutes[k - 1], minutes[k], null);
          path.y.push(before.position_m[train] / 1000, at / 1000, null);
        });
      }
      const rates = (name) => seen.map((row) => row[name]);
      const sums = seen.map((row) => row.delay_s.reduce((a, s) => a + Math.max(s, 0), 0) / 60);
      Plotly.restyle(el, {
        x: [...paths.map((p) => p.x), minutes, minutes, minutes, last.position_m.map(() => last.time_s / 60)],
        y: [...paths.map((p) => p.y), sums, rates("energy_kwh"), rates("floor_kwh"), last.position_m.map((m) => m / 1000)],
      }, [0, 1, 2, DELAY, ENERGY, FLOOR, NOW]);
      const stops = this.now.stops;
      Plotly.relayout(el, { "xaxis.range": [Math.max(from, 0) / 60, Math.max(last.time_s, 600) / 60],
        "yaxis.tickvals": stops.map((s) => s.position_m / 1000), "yaxis.ticktext": stops.map((s) => s.code) });
    }

    on_event(said) { this.say(clock(said.time_s), metropilotRetell(said.words)); }

    on_result(said) { this.root.dispatchEvent(new CustomEvent("mp-result", { detail: said.energy_kwh, bubbles: true })); }

    on_end(said) { super.on_end(said, { done: metropilotSay("at its end") }); }
  }

  let view = null;
  window.metropilotLine = (rootId, id, chart) => {
    if (view) view.close();
    const root = document.getElementById(rootId);
    Object.assign(root.dataset, { run: id, status: "running", time: 0, late: 0 });
    root.querySelector('[data-mp="log"]').replaceChildren();
    view = new Line(root, id, chart);
    history.replaceState(null, "", `/line?run=${id}`);
    view.set("status", metropilotRetell("planning the trips"));
  };
})();
