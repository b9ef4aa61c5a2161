/** The operator's seat. */
import { Connection } from "./connection.js";
import { FigureBinding } from "./figure_binding.js";
import { PictureView } from "./picture_view.js";
import { startTheme } from "./theme.js";

startTheme();
const connection = new Connection();
const figures = new FigureBinding();
figures.follow(connection);
for (const view of document.querySelectorAll("picture-view")) {
  if (view instanceof PictureView) view.follow(connection, figures);
}
