/** landline/place: one place of many rooms from static files, on the device. */
export { Place, type PlaceEvents } from "./place.js";
export type * from "./types.js";
