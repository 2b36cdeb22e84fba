// A live run in the browser: it reads the server's events and draws; the lever goes back the same way.
(() => {
  const KMH = 3.6, KWH = 3.6e6, RENEW_MS = 800, STEP = 0.1;
  const LIMIT = 0, PERMITTED = 1, PLAN = 2, DRIVEN = 3, PROTECTION = 4, HEAD = 5, COMMAND = 6, PLAN_ENERGY = 7, WHEEL = 8, LINE = 9;

  const post = (path, body, leaving) => fetch(path, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body), keepalive: leaving,
  });

  // Whose hand is on the lever: this page, for as long as it is open.
  const HOLDER = "tab-" + [...crypto.getRandomValues(new Uint8Array(2))].map((b) => b.toString(16).padStart(2, "0")).join("");

  class View {
    constructor(root, id, chart) {
      this.root = root; this.id = id; this.chart = chart;
      this.kept = []; this.drawn = 0; this.over = false; this.waiting = false; this.todo = [];
      this.share = null; this.confirmed = false; this.other = null;
      this.source = new EventSource(`/api/live/${id}/stream`);
      for (const kind of ["place", "scene", "rows", "event", "result", "end"])
        this.source.addEventListener(kind, (e) => this[kind](JSON.parse(e.data)));
      this.source.addEventListener("error", (e) => {
        if (e.data) this.say(null, JSON.parse(e.data).error.message);
        else if (this.source.readyState === EventSource.CLOSED && !this.over) this.set("status", "the server does not answer; reload the page");
      });
      this.onkey = (e) => this.key(e);
      document.addEventListener("keydown", this.onkey);
      this.onleave = () => { if (this.share !== null && !this.over) this.send({ share: null, holder: HOLDER }, true); };
      window.addEventListener("pagehide", this.onleave);
      this.timer = setInterval(() => this.renew(), RENEW_MS);
    }

    close() {
      this.source.close(); clearInterval(this.timer); this.todo = []; document.removeEventListener("keydown", this.onkey);
      this.onleave(); window.removeEventListener("pagehide", this.onleave);
    }

    part(name) { return this.root.querySelector(`[data-mp="${name}"]`); }

    set(name, text, unit) {
      const part = this.part(name);
      if (!part) return;
      part.textContent = text;
      if (unit) { const small = document.createElement("small"); small.textContent = ` ${unit}`; part.append(small); }
    }

    // While the server drives as many as it can, a run waits in a queue.
    place(said) { this.root.dataset.status = "queued"; this.set("status", `waiting: place ${said.place} in the queue; it starts by itself`); }

    scene(scene) {
      if (this.root.dataset.status === "queued") { this.root.dataset.status = "running"; this.set("status", "under way"); }
      this.now = scene;
      this.set("scheduled", scene.scheduled_time_s.toFixed(0), "s");
      const mine = scene.lever !== null && scene.lever.holder === HOLDER;
      this.other = mine ? null : scene.lever;
      if (this.share !== null && !mine && (this.other || this.confirmed)) this.drop(); else this.shown();
      const svg = this.root.querySelector(".mp-strip svg");
      if (svg) this.strip(svg, scene);
      this.draw((Plotly, el) => {
        const end = scene.length_m, limit = scene.limit;
        const xs = [...limit.from_m.map((x) => Math.max(x, 0)), end], ys = limit.limit_mps.map((v) => v * KMH);
        ys.push(ys[ys.length - 1]);
        const plan = scene.plan || { position_m: [], speed_mps: [] }, reference = scene.reference || { position_m: [], energy_wheel_j: [] };
        const top = Math.max(...ys) * 1.1;
        Plotly.restyle(el, { x: [xs, scene.permitted.position_m, plan.position_m, reference.position_m],
          y: [ys, scene.permitted.speed_mps.map((v) => v * KMH), plan.speed_mps.map((v) => v * KMH), reference.energy_wheel_j.map((j) => j / KWH)],
        }, [LIMIT, PERMITTED, PLAN, PLAN_ENERGY]);
        Plotly.relayout(el, { "xaxis.range": [-0.01 * end, 1.02 * end], "yaxis.range": [0, top],
          shapes: scene.restrictions.map((r) => ({ type: "rect", xref: "x", yref: "y", x0: r.from_m, x1: r.to_m, y0: r.limit_mps * KMH, y1: top,
            fillcolor: "rgba(213,94,0,.22)", line: { width: 0 } })) });
      });
    }

    strip(svg, scene) {
      const group = svg.querySelector(".mp-restrictions"), x0 = +svg.dataset.x0, scale = +svg.dataset.scale;
      group.replaceChildren(...scene.restrictions.map((r) => {
        const box = document.createElementNS("http://www.w3.org/2000/svg", "rect");
        const values = { x: x0 + scale * r.from_m, width: scale * (Math.min(r.to_m, scene.length_m) - r.from_m), y: +svg.dataset.rail - 4, height: 8, class: "restricted" };
        for (const [name, value] of Object.entries(values)) box.setAttribute(name, value);
        return box;
      }));
    }

    row(values) { return Object.fromEntries(this.now.columns.map((name, k) => [name, values[k]])); }

    // What is to be drawn is drawn in order, once the picture is there: the emptying first, not over what was drawn.
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

    end(said) {
      this.source.close(); this.over = true; this.drop();
      this.root.dataset.status = said.status;
      const done = this.outcome === "arrived" ? "arrived at its end" : `ended: ${(this.outcome || "").replaceAll("_", " ")}`;
      this.set("status", { done, stopped: "stopped; it can be resumed", failed: `failed: ${said.message}` }[said.status] || said.status);
      this.root.dispatchEvent(new CustomEvent("mp-end", { detail: said.status, bubbles: true }));
    }

    event(said) { this.say(said.time_s, said.words); }

    say(time, words) {
      const list = this.part("log"), item = document.createElement("li"), when = document.createElement("b");
      when.textContent = time === null ? "" : `${time.toFixed(1)} s`;
      item.append(when, words);
      list.prepend(item);
    }

    result(said) { this.outcome = said.kpis.outcome; this.root.dispatchEvent(new CustomEvent("mp-result", { detail: said, bubbles: true })); }

    take(share, over = false) {
      this.share = Math.round(Math.min(Math.max(share, -1), 1) * 100) / 100;
      this.lever(over);
    }

    drop() { this.share = null; this.confirmed = false; this.shown(); }

    give() { this.share = null; this.confirmed = false; this.lever(); }

    renew() { if (this.share !== null && !this.over) this.lever(); }

    send(body, leaving = false) { return post(`/api/live/${this.id}/lever`, body, leaving); }

    // The lever goes to the server; where somebody else holds it, it says who.
    async lever(over = false) {
      this.shown();
      if (this.over) return;
      const share = this.share, answer = await this.send({ share, holder: HOLDER, take_over: over }).catch(() => null);
      if (answer === null || this.over) return;
      if (answer.ok) { if (share !== null && this.share !== null) this.confirmed = true; return; }
      const held = this.share !== null;
      this.drop();
      if (held) this.say(null, (await answer.json()).error.message);
    }

    shown() {
      const held = this.share !== null, slider = this.part("slider"), other = held || this.over ? null : this.other;
      this.root.dataset.hand = held; this.root.dataset.holder = held ? HOLDER : other ? other.holder : "";
      this.set("hand", held ? `manual: ${(this.share * 100).toFixed(0)} %` : other ? `held by ${other.holder} since ${other.since_s.toFixed(1)} s` : "the driver has it");
      if (slider) { slider.value = held ? this.share : 0; slider.disabled = !held; }
      const button = this.part("take");
      if (button) { button.textContent = held ? "Give the lever back (Esc)" : other ? "Take the lever over" : "Take the lever (M)"; button.title = `this page is ${HOLDER}`; }
    }

    key(e) {
      if (this.over || e.ctrlKey || e.metaKey || e.altKey) return;
      const typing = e.target.closest && e.target.closest("input:not([type=range]), textarea, [role=listbox], [role=combobox]");
      if (typing) return;
      const held = this.share !== null;
      const does = { m: () => !held && !this.other && this.take(0), ArrowUp: () => held && this.take(this.share + STEP), ArrowDown: () => held && this.take(this.share - STEP),
        0: () => held && this.take(0), b: () => held && this.take(-1), Escape: () => held && this.give() }[e.key];
      if (does && does() !== false) e.preventDefault();
    }

    // Rows of the stream: kept, shown as numbers, drawn ten times a second at most.
    rows(said) {
      this.kept.push(...said.rows.map((values) => this.row(values)));
      this.root.dataset.behind = said.behind_s;
      this.set("pace", said.pace === 0 ? "waiting" : `${said.pace}×`);
      if (!this.waiting) { this.waiting = true; setTimeout(() => { this.waiting = false; this.update(); }, 90); }
    }

    update() {
      const last = this.kept[this.kept.length - 1];
      if (!last || !this.now) return;
      const scene = this.now, best = last.plan_energy_wheel_j;
      this.root.dataset.time = last.time_s; this.root.dataset.position = last.position_m;
      this.set("speed", (last.speed_mps * KMH).toFixed(1), "km/h");
      this.set("permitted", (last.permitted_mps * KMH).toFixed(1), "km/h");
      this.set("distance", (scene.length_m - last.position_m).toFixed(Math.abs(scene.length_m - last.position_m) < 20 ? 2 : 0), "m");
      this.set("time", last.time_s.toFixed(1), "s");
      const coast = Math.abs(last.command) < 0.005;
      this.set("command", coast ? "coast" : `${Math.abs(last.command * 100).toFixed(0)}`, coast ? "" : last.command > 0 ? "% power" : "% brake");
      const before = this.kept[this.kept.length - 2];
      if (before) this.set("power", ((last.energy_line_j - before.energy_line_j) / (last.time_s - before.time_s || 1) / 1000).toFixed(0), "kW");
      this.set("energy", (last.energy_wheel_j / KWH).toFixed(2), "kWh");
      this.set("against", best > 36000 ? `${((last.energy_wheel_j / best - 1) * 100).toFixed(1)}` : "–", "%");
      this.set("level", scene.levels[last.level] === "none" ? "watching" : scene.levels[last.level]);
      this.part("level").className = last.level ? "v mp-fail" : "v";
      const train = this.root.querySelector(".mp-train"), svg = train && train.closest("svg");
      if (train) {
        const along = +svg.dataset.scale * last.position_m, box = svg.parentElement.closest(".mp-strip");
        train.style.transform = `translateX(${along.toFixed(2)}px)`;
        if (box.scrollWidth > box.clientWidth) box.scrollLeft = ((+svg.dataset.x0 + along) / 1000) * box.scrollWidth - box.clientWidth / 2;
      }
      const slider = this.part("slider");
      if (slider && this.share === null) slider.value = last.wanted;
      this.draw((Plotly, el) => {
        const fresh = this.kept.slice(this.drawn);
        this.drawn = this.kept.length;
        const xs = fresh.map((r) => r.position_m);
        const hit = fresh.filter((r, k) => r.level && !((k ? fresh[k - 1] : this.before) || {}).level);
        this.before = fresh[fresh.length - 1] || this.before;
        if (fresh.length) Plotly.extendTraces(el, {
          x: [xs, xs, xs, xs, hit.map((r) => r.position_m)],
          y: [fresh.map((r) => r.speed_mps * KMH), fresh.map((r) => r.command), fresh.map((r) => r.energy_wheel_j / KWH), fresh.map((r) => r.energy_line_j / KWH), hit.map((r) => r.speed_mps * KMH)],
        }, [DRIVEN, COMMAND, WHEEL, LINE, PROTECTION]);
        Plotly.restyle(el, { x: [[last.position_m]], y: [[last.speed_mps * KMH]] }, [HEAD]);
      });
    }
  }

  let view = null;
  window.metropilot = {
    live(rootId, id, chart) {
      if (view) view.close();
      const root = document.getElementById(rootId);
      root.dataset.run = id; root.dataset.status = "running"; root.dataset.position = 0; root.dataset.time = 0;
      const list = root.querySelector('[data-mp="log"]');
      if (list) list.replaceChildren();
      view = new View(root, id, chart);
      view.draw((Plotly, el) => Plotly.restyle(el, { x: el.data.map(() => []), y: el.data.map(() => []) }));
      history.replaceState(null, "", `/?run=${id}`);
      view.set("status", "under way");
      view.shown();
    },
    hand() { if (view) view.share === null ? view.take(0, view.other !== null) : view.give(); },
    slide(value) { if (view && view.share !== null) view.take(+value); },
  };
})();
