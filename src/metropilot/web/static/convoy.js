// A live convoy in the browser: trainsets on the track, gaps and speed differences over time.
(() => {
  const KMH = 3.6;

  class Convoy {
    constructor(root, id, chart) {
      Object.assign(this, { root, id, chart, kept: [], drawn: 0, waiting: false });
      this.todo = [];
      this.source = new EventSource(`/api/live/${id}/stream`);
      for (const kind of ["place", "scene", "rows", "event", "result", "end"])
        this.source.addEventListener(kind, (e) => this["on_" + kind](JSON.parse(e.data)));
      this.source.addEventListener("error", (e) => { if (e.data) this.say("", JSON.parse(e.data).error.message); });
    }

    close() { this.source.close(); this.todo = []; }

    part(name) { return this.root.querySelector(`[data-mp="${name}"]`); }

    set(name, text, unit) {
      const part = this.part(name);
      if (!part) return;
      part.textContent = text;
      if (unit) { const small = document.createElement("small"); small.textContent = ` ${unit}`; part.append(small); }
    }

    say(when, words) {
      const item = document.createElement("li"), time = document.createElement("b");
      time.textContent = when;
      item.append(time, words);
      this.part("log").prepend(item);
    }

    // In order, as in live.js.
    draw(use) {
      this.todo.push(use);
      if (this.todo.length === 1) this.drawAll();
    }

    drawAll() {
      const el = document.getElementById("c" + this.chart), component = window.getElement && getElement(this.chart);
      if (!this.todo.length) return;
      if (!el || !component || !component.Plotly || !el.data) { setTimeout(() => this.drawAll(), 60); return; }
      for (const use of this.todo.splice(0)) use(component.Plotly, el);
    }

    // As in live.js.
    on_place(said) { this.root.dataset.status = "queued"; this.set("status", `waiting: place ${said.place} in the queue; it starts by itself`); }

    on_scene(scene) {
      const first = !this.now;
      this.now = scene;
      if (this.root.dataset.status === "queued") { this.root.dataset.status = "running"; this.set("status", "under way"); }
      this.root.dataset.silent = scene.link.silent;
      this.set("link", scene.link.silent ? "silent" : `${scene.link.delay_s} s, ${Math.round(scene.link.loss * 100)} % lost`);
      this.part("link").className = scene.link.silent ? "v mp-fail" : "v";
      if (first) this.place(scene);
    }

    // One rectangle a trainset, to scale; the browser moves them.
    place(scene) {
      const svg = this.root.querySelector(".mp-strip svg"), group = svg && svg.querySelector(".mp-convoy");
      if (!group) return;
      const scale = +svg.dataset.scale, x0 = +svg.dataset.x0, length = Math.max(scale * scene.trainset_length_m, 8);
      group.replaceChildren(...scene.starts_m.map(() => {
        const box = document.createElementNS("http://www.w3.org/2000/svg", "rect");
        const values = { x: x0 - length, y: +svg.dataset.rail - 13, width: length, height: 9, rx: 3, class: "train mp-train" };
        for (const [name, value] of Object.entries(values)) box.setAttribute(name, value);
        return box;
      }));
    }

    on_rows(said) {
      this.kept.push(...said.rows.map((values) => Object.fromEntries(this.now.columns.map((name, k) => [name, values[k]]))));
      this.root.dataset.behind = said.behind_s;
      if (!this.waiting) { this.waiting = true; setTimeout(() => { this.waiting = false; this.update(); }, 120); }
    }

    update() {
      const last = this.kept[this.kept.length - 1], scene = this.now;
      if (!last) return;
      this.root.dataset.time = last.time_s; this.root.dataset.gap = Math.min(...last.gap_m);
      this.set("time", last.time_s.toFixed(1), "s");
      this.set("speed", (last.speed_mps[0] * KMH).toFixed(1), "km/h");
      this.set("gap", Math.min(...last.gap_m).toFixed(2), "m");
      this.set("least", Math.min(...this.kept.map((r) => Math.min(...r.gap_m))).toFixed(2), "m");
      const apart = last.apart_mps.reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a), 0);
      this.set("apart", (apart * KMH).toFixed(2), "km/h");
      this.set("age", Math.max(...last.age_s).toFixed(1), "s");
      const worst = Math.max(...last.level);
      this.set("level", worst ? scene.levels[worst] : "watching");
      this.part("level").className = worst ? "v mp-fail" : "v";
      const svg = this.root.querySelector(".mp-strip svg"), boxes = svg ? svg.querySelectorAll(".mp-convoy rect") : [];
      boxes.forEach((box, k) => { box.style.transform = `translateX(${(+svg.dataset.scale * last.position_m[k]).toFixed(2)}px)`; });
      this.draw((Plotly, el) => {
        const fresh = this.kept.slice(this.drawn), pairs = last.gap_m.length, xs = fresh.map((r) => r.time_s);
        this.drawn = this.kept.length;
        if (!fresh.length) return;
        const traces = [], ys = [];
        for (let k = 0; k < pairs; k++) {
          traces.push(k, 6 + k); ys.push(fresh.map((r) => r.gap_m[k]), fresh.map((r) => r.apart_mps[k] * KMH));
        }
        for (let k = 0; k <= pairs; k++) { traces.push(12 + k); ys.push(fresh.map((r) => r.speed_mps[k] * KMH)); }
        Plotly.extendTraces(el, { x: traces.map(() => xs), y: ys }, traces);
      });
    }

    on_event(said) { this.say(`${said.time_s.toFixed(1)} s`, said.words); }

    on_result(said) { this.root.dispatchEvent(new CustomEvent("mp-result", { detail: said.success, bubbles: true })); }

    on_end(said) {
      this.source.close();
      this.root.dataset.status = said.status;
      this.set("status", { done: "all stopped", stopped: "stopped", failed: `failed: ${said.message}` }[said.status] || said.status);
    }
  }

  let view = null;
  window.metropilotConvoy = (rootId, id, chart, pairs) => {
    if (view) view.close();
    const root = document.getElementById(rootId);
    Object.assign(root.dataset, { run: id, status: "running", time: 0 });
    root.querySelector('[data-mp="log"]').replaceChildren();
    view = new Convoy(root, id, chart);
    view.draw((Plotly, el) => Plotly.restyle(el, { x: el.data.map(() => []), y: el.data.map(() => []),
      showlegend: el.data.map((t, k) => k >= 12 && k <= 12 + pairs) }));
    history.replaceState(null, "", `/convoy?run=${id}`);
    view.set("status", "under way");
  };
})();
