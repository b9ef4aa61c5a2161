/** The page's clock in ms; the same in the page and in its workers. */
export const pageMs = () => performance.timeOrigin + performance.now();
