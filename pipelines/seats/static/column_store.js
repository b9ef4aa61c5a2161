/**
 * Least and greatest value of each pixel column of a chart that scrolls: so no peak of a 1 kHz
 * signal is left out, however many samples share a column.
 *
 * Columns are numbered from the clock's zero: column n holds [n * columnUs, (n + 1) * columnUs).
 */
export class ColumnStore {
  /**
   * @param {number} columns that are kept
   * @param {number} columnUs the time that one column stands for
   * @param {number} lanes signals
   */
  constructor(columns, columnUs, lanes) {
    this.columns = columns;
    this.columnUs = columnUs;
    this.lanes = lanes;
    this.least = new Float32Array(columns * lanes);
    this.greatest = new Float32Array(columns * lanes);
    /** The number of the column that a place holds now; -1 for none. */
    this.holds = new Float64Array(columns * lanes).fill(-1);
    /** The first column that changed since `taken`; Infinity if none did. */
    this.changedFrom = Infinity;
  }

  /** The column of an instant.
   * @param {number} timeUs
   */
  columnOf(timeUs) {
    return Math.floor(timeUs / this.columnUs);
  }

  /** Put one value in. A value that is older than all columns is ignored.
   * @param {number} lane
   * @param {number} timeUs
   * @param {number} value
   */
  add(lane, timeUs, value) {
    const column = this.columnOf(timeUs);
    const place = (column % this.columns) * this.lanes + lane;
    const held = this.holds[place];
    if (column < held) return;
    if (column > held) {
      this.holds[place] = column;
      this.least[place] = value;
      this.greatest[place] = value;
    } else if (value < this.least[place]) {
      this.least[place] = value;
    } else if (value > this.greatest[place]) {
      this.greatest[place] = value;
    } else {
      return;
    }
    if (column < this.changedFrom) this.changedFrom = column;
  }

  /** The place of a column's values in `least` and `greatest`; -1 where nothing came.
   * @param {number} lane
   * @param {number} column
   */
  placeOf(lane, column) {
    if (column < 0) return -1;
    const place = (column % this.columns) * this.lanes + lane;
    return this.holds[place] === column ? place : -1;
  }

  /** Say that everything up to now has been drawn. */
  taken() {
    this.changedFrom = Infinity;
  }

  /** The greatest distance from zero of some lanes between two columns, both included.
   * @param {readonly number[]} lanes
   * @param {number} from
   * @param {number} to
   */
  reach(lanes, from, to) {
    let reach = 0;
    for (const lane of lanes) {
      for (let column = Math.max(0, from); column <= to; column++) {
        const place = this.placeOf(lane, column);
        if (place < 0) continue;
        reach = Math.max(reach, Math.abs(this.least[place]), Math.abs(this.greatest[place]));
      }
    }
    return reach;
  }
}
