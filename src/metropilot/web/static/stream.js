// What runs on the server, in the browser: numbers, news and a picture that follow its stream of events.
(() => {
  const EVERY_MS = 80;

  window.MetropilotPicture = class {
    constructor(root, chart) { Object.assign(this, { root, chart, todo: [] }); }

    // What is dragged by the pointer, in the picture; keyboards have fields and tables for it.
    handle(className, take) {
      const handle = document.createElement("div");
      handle.className = className;
      handle.ariaHidden = "true";
      handle.addEventListener("pointerdown", (e) => {
        if (e.button) return;
        e.preventDefault(); e.stopPropagation();
        handle.setPointerCapture(e.pointerId);
        take(e);
      });
      handle.addEventListener("pointermove", (e) => this.move(e));
      for (const name of ["pointerup", "pointercancel"]) handle.addEventListener(name, () => this.leave());
      return handle;
    }

    // While it is dragged, what is sent is sent now and then.
    soon(send) { if (!this.sending) this.sending = setTimeout(() => { this.sending = null; send(); }, EVERY_MS); }

    static snap(value, grid) { return Math.round(value / grid) * grid; }

    part(name) { return this.root.querySelector(`[data-mp="${name}"]`); }

    set(name, text, unit) {
      const part = this.part(name);
      if (!part) return;
      part.textContent = text;
      if (unit) { const small = document.createElement("small"); small.textContent = ` ${unit}`; part.append(small); }
    }

    // A strip that is wider than the screen follows its trainset.
    follow(svg, along) {
      const box = svg.parentElement.closest(".mp-strip");
      if (box.scrollWidth > box.clientWidth) box.scrollLeft = ((+svg.dataset.x0 + along) / 1000) * box.scrollWidth - box.clientWidth / 2;
    }

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
  };

  window.MetropilotStream = class extends MetropilotPicture {
    constructor(root, id, chart) {
      super(root, chart);
      Object.assign(this, { id, kept: [], drawn: 0, waiting: false, over: false });
      this.source = new EventSource(`/api/live/${id}/stream`);
      for (const kind of ["place", "scene", "rows", "event", "result", "end"])
        this.source.addEventListener(kind, (e) => this["on_" + kind](JSON.parse(e.data)));
      this.source.addEventListener("error", (e) => {
        if (e.data) this.say("", metropilotRetell(JSON.parse(e.data).error.message));
        else if (this.source.readyState === EventSource.CLOSED && !this.over) this.set("status", metropilotSay("the server does not answer; reload the page"));
      });
    }

    close() { this.source.close(); this.over = this.closed = true; this.todo = []; }

    say(when, words) {
      const item = document.createElement("li"), time = document.createElement("b");
      time.textContent = when;
      item.append(time, words);
      this.part("log").prepend(item);
    }

    // While the server drives as many as it can, a run waits in a queue.
    on_place(said) { this.root.dataset.status = "queued"; this.set("status", metropilotSay("waiting: place {place} in the queue; it starts by itself", { place: said.place })); }

    on_scene(scene) {
      if (this.root.dataset.status === "queued") { this.root.dataset.status = "running"; this.set("status", metropilotSay("under way")); }
      this.now = scene;
    }

    // Rows are kept, and shown and drawn as often as `every` says.
    on_rows(said, every) {
      this.kept.push(...said.rows.map((values) => Object.fromEntries(this.now.columns.map((name, k) => [name, values[k]]))));
      this.root.dataset.behind = said.behind_s;
      this.set("pace", said.pace === 0 ? metropilotSay("paused") : `${said.pace}×`);
      if (!this.waiting) { this.waiting = true; setTimeout(() => { this.waiting = false; if (!this.over) this.newest(); }, every); }
    }

    newest() { if (this.kept.length) this.update(this.kept[this.kept.length - 1]); }

    on_event(said) { this.say(`${said.time_s.toFixed(1)} s`, metropilotRetell(said.words)); }

    on_end(said, words) {
      this.newest();
      this.source.close(); this.over = true;
      this.root.dataset.status = said.status;
      this.set("status", {
        stopped: metropilotSay("stopped; it can be resumed"),
        failed: metropilotSay("failed: {message}", { message: metropilotRetell(said.message) }), ...words,
      }[said.status] || metropilotRetell(said.status));
    }
  };
})();
