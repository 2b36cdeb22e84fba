// The cells of a table. NiceGUI compiles a cell that is given as text at every drawing, which takes the
// focus, and a key half pressed, from what is in it; these are compiled once and stay.
export default {
  template: `
    <q-table ref="qRef" :columns="shown">
      <template v-slot:header-cell="cell">
        <q-th :props="cell" :aria-sort="order(cell.col)">
          <button v-if="cell.col.sortable" type="button" class="mp-sort" :aria-label="say('Sort by {column}', { column: cell.col.label })">{{ cell.col.label }}</button>
          <template v-else>{{ cell.col.label }}</template>
        </q-th>
      </template>
      <template v-slot:header-selection="scope">
        <q-checkbox dense v-model="scope.selected" :aria-label="say('Select all')" />
      </template>
      <template v-slot:body-selection="scope">
        <q-checkbox dense v-model="scope.selected" :aria-label="say('Select {row}', { row: scope.row.words || scope.row.id })" />
      </template>
      <template v-slot:body-cell="cell">
        <q-td v-if="cell.col.kind === 'actions'" :props="cell" class="mp-do">
          <q-btn v-for="name in cell.row.actions" :key="name" flat dense no-caps size="sm" :label="cell.col.labels[name]"
            :aria-label="say('{action} {row}', { action: cell.col.labels[name], row: cell.row.words })" @click="$emit('act', { name, id: cell.row.id })" />
        </q-td>
        <q-td v-else :props="cell">
          <a v-if="cell.col.kind === 'link' && cell.row.link" :href="cell.row.link" class="mp-cell-link">{{ cell.value }}</a>
          <span v-else :class="cell.col.kind === 'styled' ? cell.row.style : undefined">{{ cell.value }}</span>
        </q-td>
      </template>
    </q-table>
  `,
  props: { columns: Array },
  emits: ["act"],
  computed: {
    shown() {
      const format = (digits) => (value) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−"));
      return this.columns.map((column) => ("digits" in column ? { ...column, format: format(column.digits) } : column));
    },
  },
  methods: {
    say: (text, values) => metropilotSay(text, values),
    order(column) {
      if (!column.__thClass.includes(" sorted")) return null;
      return column.__thClass.includes("sort-desc") ? "descending" : "ascending";
    },
  },
};
