// Texts of the scripts in the language of the page; see metropilot.web.words.browser.
(() => {
  const { words = {}, sentences = [], joints = [], and = "", numbers = [], number = "" } = window.metropilotWords || {};
  const fill = (text, values) => text.replace(/\{(\w+)\}/g, (all, name) => (name in values ? values[name] : all));
  const quote = (text) => text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
  const patterns = sentences.map((text) => {
    const names = [], parts = text.split(/\{(\w+)\}/);
    const source = parts.map((part, k) => (k % 2 ? (names.push(part), `(${numbers.includes(part) ? number : ".+?"})`) : quote(part))).join("");
    return { text, names, pattern: new RegExp(`^${source}$`) };
  });

  window.metropilotSay = (text, values = {}) => fill(words[text] || text, values);

  // What the server says in English, as metropilot.web.words.said does it.
  window.metropilotRetell = (text) => {
    if (!text || !patterns.length) return text;
    if (words[text]) return words[text];
    for (const { text: message, names, pattern } of patterns) {
      const found = text.match(pattern);
      if (found) return metropilotSay(message, Object.fromEntries(names.map((name, k) => [name, metropilotRetell(found[k + 1])])));
    }
    for (const joint of joints) {
      const parts = text.split(joint), told = parts.map((part) => (parts.length > 1 ? metropilotRetell(part) : part));
      const changed = told.map((part, k) => part !== parts[k]);
      if (joint === and ? changed.every(Boolean) : changed.some(Boolean)) return told.join(words[joint] || joint);
    }
    return text;
  };
})();
